import sys

import pytest
import torch
from made_up import observations
from pretend_device import pretend_device
from refusals import refused
from torch import nn

from objectfolder.base.errors import ObjectFolderError
from objectfolder.benchmarks.models import encoders
from objectfolder.benchmarks.models.encoders import (
    check_encoder,
    make_encoder,
    own_code,
    read_weights,
    register_encoder,
    registered,
)
from objectfolder.benchmarks.models.inputs import encoder_inputs
from objectfolder.benchmarks.models.resnet import ResNet18
from objectfolder.benchmarks.models.settings import EncodeConfig, InputSizes

SIZES = InputSizes(image=56, spectrogram=(64, 50), touch=(64, 48))


@pytest.fixture(scope="module")
def imagenet(tmp_path_factory):
    """A file as torchvision publishes it."""
    path = tmp_path_factory.mktemp("weights") / "resnet18.pth"
    torch.manual_seed(5)
    torch.save(
        {**ResNet18(3).state_dict(), "fc.weight": torch.ones(1000, 512), "fc.bias": torch.ones(1000)}, path
    )
    return path


def _stored(path):
    return torch.load(path, weights_only=True)


def test_weights_of_torchvision_are_taken_but_for_the_last_layer(imagenet):
    stored = _stored(imagenet)
    state = make_encoder("resnet18", "touch", read_weights(imagenet)).state_dict()
    assert set(stored) - set(state) == {"fc.weight", "fc.bias"}
    assert all(torch.equal(state[name], stored[name]) for name in state)


def test_one_channel_sees_what_three_equal_channels_see(imagenet):
    weights = read_weights(imagenet)
    grey, colour = (make_encoder("resnet18", m, weights).eval() for m in ("audio", "vision"))
    x = torch.randn(2, 1, 64, 50)
    with torch.no_grad():
        torch.testing.assert_close(grey(x), colour(x.expand(-1, 3, -1, -1)), rtol=1e-4, atol=1e-5)


def test_prefix_and_wrapping_of_parallel_training_and_lacking_counters_do_not_matter(imagenet, tmp_path):
    stored, path = _stored(imagenet), tmp_path / "parallel.pth"
    old = {name: value for name, value in stored.items() if not name.endswith("num_batches_tracked")}
    torch.save({"epoch": 3, "state_dict": {f"module.{name}": value for name, value in old.items()}}, path)
    weights = read_weights(path)
    assert list(weights) == [name for name in old if not name.startswith("fc.")]
    assert all(torch.equal(value, stored[name]) for name, value in weights.items())
    make_encoder("resnet18", "vision", weights)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda s: s.pop("layer1.0.bn1.weight"), "lacks layer1.0.bn1.weight; expected the 120 tensors"),
        (lambda s: s.update({"layer5.weight": torch.ones(1)}), "unexpectedly holds layer5.weight"),
        (lambda s: s.update({"bn1.bias": torch.ones(65)}), r"bn1.bias has shape \(65,\), expected \(64,\)"),
        (lambda s: s.update({"conv1.weight": torch.ones(64, 4, 7, 7)}), r"conv1.weight .* \(64, 4, 7, 7\)"),
        (lambda s: s.update({"bn1.bias": torch.full((64,), torch.nan)}), "bn1.bias are not finite"),
        (lambda s: s.update({"epoch": 4}), "holds epoch, which are no tensors"),
        (
            lambda s: [s.pop(name) for name in list(s) if name.startswith("layer4")],
            r"lacks layer4.0.conv1.weight, layer4.0.bn1.weight, layer4.0.bn1.bias and \d+ more",
        ),
    ],
)
def test_weights_of_another_net_are_refused(imagenet, tmp_path, change, message):
    stored = _stored(imagenet)
    change(stored)
    path = tmp_path / "other.pth"
    torch.save(stored, path)
    refused(rf"other\.pth:? .*{message}", lambda: make_encoder("resnet18", "vision", read_weights(path)))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        *(
            (content, "is not a readable checkpoint")
            for content in (b"", b"text", b"\x80\x04c\nos\nsystem\n")
        ),
        (torch.ones(3), "holds Tensor; expected a dictionary"),
        (None, "does not exist"),
    ],
)
def test_file_that_is_no_checkpoint_is_named(tmp_path, content, message):
    path = tmp_path / "some.pth"
    if isinstance(content, bytes):
        path.write_bytes(content)
    elif content is not None:
        torch.save(content, path)
    refused(rf"some\.pth {message}", read_weights, path)


def test_own_encoder_is_made_by_its_name_for_the_channels_of_a_modality(monkeypatch):
    # Without those that other tests register.
    monkeypatch.setattr(encoders, "_FACTORIES", {"resnet18": ResNet18})

    @register_encoder("mean")
    class Mean(nn.Module):
        features = 2

        def __init__(self, channels):
            super().__init__()
            self.channels = channels

    assert [make_encoder("mean", m).channels for m in ("vision", "audio", "touch")] == [3, 1, 3]
    refused("encoder 'vgg' is not one of mean, resnet18", make_encoder, "vgg", "vision")


def test_a_file_registers_its_encoder_and_is_run_by_nobody_else(tmp_path, monkeypatch):
    monkeypatch.setattr(encoders, "_FACTORIES", dict(encoders._FACTORIES))
    path = tmp_path / "mine.py"
    path.write_text(
        "from torch import nn\n"
        "from objectfolder.benchmarks.models.encoders import register_encoder\n"
        'register_encoder("of_a_file")(lambda channels: nn.Conv2d(channels, 1, 1))\n'
    )
    with pytest.raises(ObjectFolderError, match="is not one of"):  # a model's header may say anything
        make_encoder(f"{path}:of_a_file", "vision")
    assert "of_a_file" not in encoders._FACTORIES
    assert registered(f"{path}:of_a_file") == "of_a_file"
    assert make_encoder("of_a_file", "audio").in_channels == 1
    refused("'nothing' is not one of", registered, f"{path}:nothing")
    refused(r"mine2\.py does not exist", registered, f"{tmp_path / 'mine2.py'}:of_a_file")


OWN = """
from torch import nn
from objectfolder.benchmarks.models.encoders import register_encoder

@register_encoder("own")
class Own(nn.Sequential):
    features = 4

    def __init__(self, channels):
        super().__init__(nn.Conv2d(channels, 4, 5, 3), nn.AdaptiveAvgPool2d(1), nn.Flatten())
"""


@pytest.fixture
def own(tmp_path, monkeypatch):
    """Writes an encoder's file, and returns the section that names it."""
    monkeypatch.setattr(encoders, "_FACTORIES", dict(encoders._FACTORIES))

    def write(text):
        path = tmp_path / "mine.py"
        path.write_text(text)
        return EncodeConfig(encoder=f"{path}:own", image=56, spectrogram=(64, 50), touch=(64, 48))

    yield write
    for module in ("beside", "package", "package.inner"):
        sys.modules.pop(module, None)


@pytest.mark.parametrize(
    ("text", "instead", "message"),
    [
        ("from torch import nn", "def (", r"mine.py failed: SyntaxError: .*\(mine.py, line 2\)$"),
        ("from torch import nn", "import nowhere", r"mine.py failed: ModuleNotFoundError: .* \(line 2\)$"),
        ("from torch import nn", "raise SystemExit(2)", r"mine.py failed: SystemExit: 2 \(line 2\)$"),
        ("(self, channels)", "(self)", r"vision of shape \(2, 3, 56, 56\): failed: TypeError: .*__init__"),
        ("channels, 4, 5", "3, 4, 5", r"audio of shape \(2, 1, 64, 50\): failed: RuntimeError: "),
        ("super()", "super(", "failed: SyntaxError"),
        ("super()", "1 / 0; super()", r"failed: ZeroDivisionError: division by zero \(line 10\)$"),
        ("features = 4", "pass", r"vision .*: its attribute features is None, expected .* at least 1"),
        ("features = 4", "features = 4.0", "its attribute features is 4.0"),
        ("features = 4", "features = True", "its attribute features is True"),
        ("features = 4", "features = 8", r"vision .*: gives \(2, 4\), expected \(2, 8\)"),
        (", nn.Flatten()", "", r"vision .*: gives \(2, 4, 1, 1\), expected \(2, 4\)"),
        ("nn.Flatten()", "nn.Flatten(), nn.LSTM(4, 4)", r"gives tuple, expected \(2, 4\)"),
    ],
)
def test_an_own_encoder_that_fails_is_named_before_any_work(own, text, instead, message):
    encode = own(OWN.replace(text, instead))
    assert text in OWN
    refused(rf"(?s)^encoder .*mine\.py:own.*{message}", check_encoder, encode, ("vision", "audio", "touch"))


def test_an_encoder_is_checked_without_a_trace(own, imagenet):
    encode = own(OWN.replace("nn.Conv2d", "nn.BatchNorm2d(channels), nn.Conv2d"))
    state, path = torch.get_rng_state(), list(sys.path)
    check_encoder(encode, ("vision", "audio", "touch"))
    assert torch.equal(torch.get_rng_state(), state)
    assert sys.path == path
    check_encoder(encode, ())
    refused("is not one of", check_encoder, EncodeConfig(**vars(encode) | {"encoder": "vgg"}), ())
    refused(r"expected the .* tensors of own", check_encoder, encode, ("vision",), read_weights(imagenet))


def test_the_code_of_an_encoder_is_its_file_and_the_modules_beside_it(own, tmp_path):
    imports = "import poplib, scipy.datasets\nfrom beside import WIDTH\nfrom package.inner import DEPTH\n"
    encode = own(imports + OWN.replace("features = 4", "features = WIDTH").replace("4, 5, 3", "WIDTH, 5, 3"))
    (tmp_path / "package").mkdir()
    (tmp_path / "package/inner.py").write_text("DEPTH = 1")
    (tmp_path / "beside.py").write_text("WIDTH = 4")
    assert own_code("resnet18") == []
    before = own_code(encode.encoder)
    assert len(before) == 3
    assert own_code(encode.encoder) == before
    assert registered(encode.encoder) == "own"
    assert own_code(encode.encoder) == before
    (tmp_path / "beside.py").write_text("WIDTH = 16")
    assert own_code(encode.encoder) != before
    check_encoder(encode, ("vision",))
    assert make_encoder("own", "vision").features == 16
    (tmp_path / "beside.py").write_text("WIDTH = 4")
    assert own_code(encode.encoder) == before


@pytest.mark.parametrize("modality", ["vision", "audio", "touch"])
def test_inputs_and_features_on_a_device_are_those_of_the_cpu(modality, rng):
    raw = observations(rng, 2)[modality]
    here = encoder_inputs(modality, raw, SIZES)
    with pretend_device() as device:
        net = make_encoder("resnet18", modality).eval()
        there = encoder_inputs(modality, raw, SIZES, device=device)
        assert there.device.type == device
        features = net.to(device)(there).cpu()
        there = there.cpu()
    torch.testing.assert_close(there, here, rtol=0, atol=0)
    torch.testing.assert_close(features, net.cpu()(here), rtol=1e-5, atol=1e-6)
