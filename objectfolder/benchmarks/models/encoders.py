"""Registered encoders, those of a user's own files, and pretrained weights."""

import sys
import sysconfig
import traceback
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from itertools import chain
from pathlib import Path
from runpy import run_path

import torch
from torch import nn

from objectfolder.base.arrays import torch_problem
from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.io import file_digest
from objectfolder.benchmarks.models.inputs import CHANNELS
from objectfolder.benchmarks.models.resnet import ResNet18
from objectfolder.benchmarks.models.settings import EncodeConfig

Factory = Callable[[int], nn.Module]
_FACTORIES: dict[str, Factory] = {}
_IMPORTED: dict[Path, dict[str, Path]] = {}  # own modules that an encoder's file imported, and their files
_PACKAGE = Path(__file__).parents[2]


def register_encoder(name: str) -> Callable[[Factory], Factory]:
    """Return a decorator that registers an encoder under a name.

    The decorated callable takes the number of input channels and returns a module with an attribute
    ``features`` that maps (B, channels, H, W) to (B, features).
    """

    def register(factory: Factory) -> Factory:
        _FACTORIES[name] = factory
        return factory

    return register


register_encoder("resnet18")(ResNet18)
register_encoder("resnet18_half")(partial(ResNet18, width=1 / 2))
register_encoder("resnet18_quarter")(partial(ResNet18, width=1 / 4))


def own_file(name: str) -> Path | None:
    """Return the file that registers an encoder with a name such as ``mine.py:small``."""
    file, colon, _ = name.rpartition(":")
    return Path(file) if colon else None


class Weights(dict[str, torch.Tensor]):
    """Tensors of a checkpoint by name, and their file."""

    def __init__(self, path: Path, tensors: Mapping[str, torch.Tensor]):
        super().__init__(tensors)
        self.path = path


def registered(name: str) -> str:
    """Return the registered name of an encoder: of one that is, or of ``FILE.py:NAME``.

    That Python file is run to register it. It may import modules beside it, which are run again, too,
    whenever it is. Raises ObjectFolderError if there is no such encoder, or its file fails.
    """
    file = own_file(name)
    if file is not None:
        if not file.is_file():
            raise ObjectFolderError(f"encoder {name}: {file} does not exist; expected FILE.py:NAME")
        _run(name, file)
    bare = name.rpartition(":")[2]
    _factory(bare)
    return bare


def own_code(name: str) -> list[str]:
    """Return the digests of an encoder's file and of the modules that it imports, unless they are installed.

    There are none for an encoder of this package. The file is run, unless it was in this process.
    """
    file = own_file(name)
    if file is None:
        return []
    if file.resolve() not in _IMPORTED:
        registered(name)
    return [file_digest(path) for path in (file, *sorted(set(_IMPORTED[file.resolve()].values())))]


def _run(name: str, file: Path) -> None:
    place = file.resolve()
    for each in chain.from_iterable(_IMPORTED.values()):  # changed since, or of another file's folder
        sys.modules.pop(each, None)
    before = set(sys.modules)
    sys.path.insert(0, str(place.parent))  # as `python FILE.py` does
    try:
        run_path(str(file))
    except (Exception, SystemExit) as error:  # it is anybody's
        raise ObjectFolderError(f"encoder {name}: {file} failed: {_problem(error, file)}") from error
    finally:
        sys.path.remove(str(place.parent))
    files = {each: getattr(sys.modules[each], "__file__", None) for each in sys.modules.keys() - before}
    _IMPORTED[place] = {each: Path(found) for each, found in files.items() if found and _is_own(found)}


def _is_own(path: str) -> bool:
    """Return whether a module's file is neither installed nor of Python or this package."""
    file, others = Path(path), [_PACKAGE, *(Path(sysconfig.get_path(of)) for of in ("stdlib", "platstdlib"))]
    installed = {"site-packages", "dist-packages"}.intersection(file.parts)
    return file.is_file() and not installed and not any(file.is_relative_to(other) for other in others)


def _problem(error: BaseException, file: Path | None) -> str:
    """Return an exception's type and text, and where in an encoder's file it was raised, if it was."""
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(file)]
    return f"{type(error).__name__}: {error}" + (f" (line {frames[-1].lineno})" if frames else "")


def _factory(name: str) -> Factory:
    if name not in _FACTORIES:
        raise ObjectFolderError(
            f"encoder {name!r} is not one of {', '.join(sorted(_FACTORIES))}; "
            "give your own as --encoder FILE.py:NAME, which registers it (docs/benchmarks.md)"
        )
    return _FACTORIES[name]


def make_encoder(name: str, modality: str, weights: Weights | None = None) -> nn.Module:
    """Make a registered encoder for a modality: "vision", "audio" or "touch".

    Its random parameters come from torch's global generator: call within `objectfolder.base.seeding.seeded`.
    The name is one that `registered` returns: no file is run here, since names may come from untrusted model
    files. A convolution over three channels of given initial weights is summed over them if the encoder takes
    one. Raises ObjectFolderError if there is no such encoder, or the weights do not fit it.
    """
    encoder = _factory(name)(CHANNELS[modality])
    if weights is not None:
        encoder.load_state_dict(_matched(weights, encoder.state_dict(), name))
    return encoder


def check_encoder(encode: EncodeConfig, modalities: Iterable[str], weights: Weights | None = None) -> None:
    """Make an encoder for some modalities, and let it answer two blank inputs of each: before any work.

    Raises ObjectFolderError if there is no such encoder, it fails, lacks the attribute ``features``, answers
    in another shape than (B, features), or the weights do not fit it.
    """
    name = registered(encode.encoder)
    for modality in modalities:
        shape = 2, CHANNELS[modality], *encode.sizes.of(modality)
        given = f"encoder {encode.encoder}, {modality} of shape {shape}"
        try:
            with torch.random.fork_rng(devices=[]), torch.no_grad():
                encoder = make_encoder(name, modality, weights).eval()
                answer = encoder(torch.zeros(shape))
        except ObjectFolderError:
            raise
        except Exception as error:  # it is anybody's
            problem = _problem(error, own_file(encode.encoder))
            raise ObjectFolderError(f"{given}: failed: {problem}") from error
        features = getattr(encoder, "features", None)
        if not isinstance(features, int) or isinstance(features, bool) or features < 1:
            raise ObjectFolderError(
                f"{given}: its attribute features is {features!r}, expected how many numbers it gives for an "
                "input, a whole number of at least 1"
            )
        found = tuple(answer.shape) if isinstance(answer, torch.Tensor) else type(answer).__name__
        if found != (2, features):
            raise ObjectFolderError(f"{given}: gives {found}, expected {(2, features)}: (B, features)")


def read_weights(path: str | Path) -> Weights:
    """Read an encoder's weights from a ``torch.save`` file, such as torchvision's ImageNet weights.

    The last layer (``fc``) and the prefix ``module.`` of parallel training are dropped. Nothing in the file
    is executed. Raises ObjectFolderError if it is missing or is no checkpoint of tensors.
    """
    path = Path(path)
    expected = "expected a dictionary of tensors by name, such as torchvision's resnet18 file"
    if not path.is_file():
        raise ObjectFolderError(f"{path} does not exist; {expected}")
    try:
        stored = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # the unpickler raises any exception
        reason = torch_problem(error)
        raise ObjectFolderError(f"{path} is not a readable checkpoint ({reason}); {expected}") from error
    if isinstance(stored, Mapping) and isinstance(stored.get("state_dict"), Mapping):
        stored = stored["state_dict"]
    if not isinstance(stored, Mapping) or not stored:
        raise ObjectFolderError(f"{path} holds {type(stored).__name__}; {expected}")
    others = [str(name) for name, value in stored.items() if not isinstance(value, torch.Tensor)]
    if others:
        raise ObjectFolderError(f"{path} holds {_some(others)}, which are no tensors; {expected}")
    tensors = {str(name).removeprefix("module."): value for name, value in stored.items()}
    broken = [name for name, value in tensors.items() if not value.isfinite().all()]
    if broken:
        raise ObjectFolderError(f"{path}: {_some(broken)} are not finite; take another file")
    return Weights(path, {name: value for name, value in tensors.items() if not name.startswith("fc.")})


def _matched(weights: Weights, expected: Mapping[str, torch.Tensor], encoder: str) -> dict[str, torch.Tensor]:
    """Return the weights as a state dictionary of an encoder."""
    # Files older than PyTorch 0.4 lack the counters, which a fixed momentum does not use.
    missing = [n for n in expected if n not in weights and not n.endswith("num_batches_tracked")]
    unexpected = [name for name in weights if name not in expected]
    if missing or unexpected:
        differences = [
            f"{word} {_some(names)}"
            for word, names in [("lacks", missing), ("unexpectedly holds", unexpected)]
            if names
        ]
        raise ObjectFolderError(
            f"{weights.path} {' and '.join(differences)}; expected the {len(expected)} tensors of {encoder}"
        )
    matched = dict(expected)
    for name, value in weights.items():
        shape = expected[name].shape
        if value.ndim == 4 and value.shape[1] == 3 and shape[1] == 1:
            value = value.sum(1, keepdim=True)  # same output for a grey image as for three equal channels
        if value.shape != shape:
            raise ObjectFolderError(
                f"{weights.path}: {name} has shape {tuple(value.shape)}, expected {tuple(shape)} of {encoder}"
            )
        matched[name] = value
    return matched


def _some(names: list[str]) -> str:
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
