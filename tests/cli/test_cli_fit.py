"""`objectfolder fit sound`: from recordings to params.yaml, or a reason why not."""

from pathlib import Path

import numpy as np
import pytest
import soundfile
from taps import MODES, RATE, taps
from typer.testing import CliRunner

from objectfolder.base.arrays import write_npz
from objectfolder.base.io import write_json
from objectfolder.base.materials import material, own_material
from objectfolder.cli import app
from objectfolder.workspace import params
from objectfolder.workspace.check import check_all
from objectfolder.workspace.layout import Build

STIFFNESS = 1.04


@pytest.fixture
def built(workspace):
    """A mug whose modes are those of the recordings, but for its stiffness."""
    hertz = np.append(np.array(MODES)[:, 0] / STIFFNESS**0.5, [2600.0, 19000.0])
    build, ceramic = Build("mug"), material("ceramic")
    write_npz(build.modes, eigenvalues=(2 * np.pi * np.sort(hertz)) ** 2)
    write_json(build.modal, {"material": "ceramic", "material_properties": ceramic.properties()})
    return workspace


@pytest.fixture
def recordings(tmp_path):
    paths = []
    for i, sound in enumerate(taps(MODES, 4)):
        paths.append(str(tmp_path / f"tap{i}.wav"))
        soundfile.write(paths[-1], np.stack([0.5 * sound, sound], 1), RATE, subtype="PCM_16")
    return paths


def run(*arguments):
    return CliRunner().invoke(app, ["fit", "sound", *map(str, arguments)])


def test_the_fitted_material_goes_to_params(built, recordings):
    before = (built / "params.yaml").read_text()
    shown = run("mug", *recordings, "--dry-run")
    assert shown.exit_code == 0, shown.output
    assert f"{len(MODES)} of {len(MODES)} heard modes matched" in shown.output
    assert f"modes below 200 Hz are not used: 0 of {len(MODES) + 2} computed ones" in shown.output
    assert (built / "params.yaml").read_text() == before
    assert run("mug", *recordings).exit_code == 0
    check_all(params.read())
    entry = params.read()["objects"]["mug"]["material"]
    fitted = own_material(entry)
    assert fitted.youngs_modulus == pytest.approx(STIFFNESS * material("ceramic").youngs_modulus, rel=1e-3)
    assert fitted.law == "loss_factor"
    assert (
        "  mug: {mesh: data/objects/mug/mesh.glb, material: {base: ceramic, "
        in Path("params.yaml").read_text()
    )
    assert run("mug", *recordings, "--law", "rayleigh").exit_code == 0  # again, on what it wrote
    assert own_material(params.read()["objects"]["mug"]["material"]).law == "rayleigh"


def test_a_recording_without_a_strike_is_named(built, recordings, tmp_path):
    noise = tmp_path / "[noise].wav"
    soundfile.write(noise, 0.1 * np.random.default_rng(0).standard_normal(2 * RATE).clip(-4, 4), RATE)
    lines = run("mug", *recordings, noise, "--dry-run").output.splitlines()
    assert [line for line in lines if "no tap" in line] == [f"{noise}: no tap found, left out"]


def test_an_object_is_named_by_its_file_too(built, recordings, tmp_path):
    Build("mug").object_file.write_bytes(b"packed")
    shown = run(Build("mug").object_file, *recordings, "--dry-run")
    assert shown.output == run("mug", *recordings, "--dry-run").output
    (tmp_path / "mug.safetensors").write_bytes(b"of others")
    refusal = str(run(tmp_path / "mug.safetensors", *recordings).exception)
    assert refusal.endswith(
        "not built in this workspace; expected a key of params.yaml, or build/KEY/ObjectFile.safetensors"
    )


def test_the_next_command_is_in_one_line(built, recordings, monkeypatch):
    monkeypatch.setenv("COLUMNS", "40")
    last = run("mug", *recordings).output.splitlines()[-1]
    assert last == "wrote objects.mug.material to params.yaml; next: objectfolder build mug"


def test_density_and_poissons_ratio_stay_as_they_are(built, recordings):
    own = {"base": "ceramic", "density": 2400.0, "poisson_ratio": 0.22}
    write_json(
        Build("mug").modal, {"material": "ceramic", "material_properties": own_material(own).properties()}
    )
    assert run("mug", *recordings).exit_code == 0
    entry = params.read()["objects"]["mug"]["material"]
    assert own.items() <= entry.items()
    check_all(params.read())


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda sound: 0 * sound, "is silent"),
        (lambda sound: np.clip(40 * sound, -1, 1), "is clipped"),
        (lambda sound: sound[::6], "7350 Hz"),
        (lambda sound: sound[: RATE // 4], "no strike"),
    ],
)
def test_recordings_that_tell_nothing_are_refused(built, tmp_path, spoil, message):
    sound, path = spoil(taps(MODES, 1)[0]), tmp_path / "bad.wav"
    soundfile.write(path, sound, RATE // 6 if len(sound) < RATE // 2 and "Hz" in message else RATE)
    result = run("mug", path)
    assert result.exit_code == 1
    assert message in str(result.exception)


def test_what_is_no_recording_or_no_object_is_named(built, recordings, tmp_path):
    (tmp_path / "text.wav").write_text("no audio")
    assert "text.wav is not a readable audio file" in str(run("mug", tmp_path / "text.wav").exception)
    assert "nowhere.wav does not exist" in str(run("mug", tmp_path / "nowhere.wav").exception)
    slow = tmp_path / "slow.wav"
    soundfile.write(slow, taps(MODES, 1)[0], 16000)
    assert "slow.wav has 16000 Hz, the others up to 44100 Hz" in str(run("mug", *recordings, slow).exception)
    assert "cup" in str(run("cup", recordings[0]).exception)
    assert "--law 'magic' is not one of rayleigh, loss_factor" in str(
        run("mug", recordings[0], "--law", "magic").exception
    )
    assert "build" in str(run("bell", recordings[0]).exception)  # never built
