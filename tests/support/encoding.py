"""What tasks under test encode with."""

from dataclasses import replace

from objectfolder.benchmarks.models.settings import EncodeConfig

_PLAIN = EncodeConfig(
    **{"encoder": "resnet18", "image": 8, "spectrogram": (8, 8), "touch": (8, 8)},
    **{"subtract": False, "shift": 0, "flip": False, "precision": "float32"},
)


def encoding(encoder="resnet18", sizes=None, **changes):
    """Return a section ``encode`` for inputs of these sizes, `InputSizes`, that is plain but for changes."""
    given = {} if sizes is None else vars(sizes)
    return replace(_PLAIN, encoder=encoder, **given, **changes)
