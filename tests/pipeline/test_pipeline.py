"""The real DAG on two tiny objects: what runs, what does not, and that it gives the same bytes twice."""

import json
import re
import shutil
import signal
import subprocess
import sys
from functools import partial
from pathlib import Path

import igl
import numpy as np
import pytest
import torch
from conftest import ROOT, Workspace
from refusals import refused
from ruamel.yaml import YAML

from objectfolder import ObjectFile
from objectfolder.base.arrays import read_npz
from objectfolder.base.io import read_json
from objectfolder.benchmarks.datasets.grasps import Grasps
from objectfolder.benchmarks.models.shape_model import load_model
from objectfolder.mesh.ply import read_surface
from objectfolder.mesh.reading.load import load_mesh
from objectfolder.vision.cameras import Intrinsics
from objectfolder.vision.view import draw
from objectfolder.workspace.layout import Benchmarks, Build
from objectfolder.workspace.stages import ROBOT_STAGES

pytestmark = pytest.mark.xdist_group("pipeline")
LANES = ("normalize", "voxelize", "modal", "radiation", "render_views", "render_touch")
NETS = ("train_vision", "train_audio", "train_touch", "pack", "evaluate")
OBSERVED = {f"{stage}@{key}" for stage in ("observe", "close_ups") for key in ("bell", "cube")}


def test_everything_is_built_and_a_second_build_runs_nothing(built):
    for key in ("cube", "bell"):
        assert (built.root / f"build/{key}/ObjectFile.safetensors").stat().st_size > 10_000
        metrics = json.loads((built.root / f"metrics/{key}.json").read_text())
        assert metrics["vision"]["psnr"] > metrics["vision"]["baseline_white"]
        assert metrics["audio"]["psnr"] > metrics["audio"]["baseline_silence"]
        assert metrics["audio"]["frequency_error"] == metrics["audio"]["decay_time_error"] == 0
        assert (built.root / f"build/{key}/sound.png").stat().st_size > 10_000
        assert 10_000 < (built.root / f"build/{key}/vision.png").stat().st_size < 300_000
        assert metrics["touch"]["psnr"] > metrics["touch"]["baseline_mean_image"]
        assert metrics["audio"]["modes_found"] >= metrics["audio"]["modes"] > 0
        assert 0 <= metrics["audio"]["lost_energy"] < 0.5
    assert built.build() == set()
    summary = built.cli("build").stdout
    built.run("-c", "from objectfolder.engine.unchanged import recall; assert recall()")
    for key in ("cube", "bell"):
        uncertainty = json.loads((built.root / f"build/{key}/modal.json").read_text())[
            "frequency_uncertainty"
        ]
        assert (f"warning: {key}: frequencies may be {uncertainty:.0%} wrong" in summary) == (
            uncertainty > 0.1
        )
    assert built.cli("status", "--check").stdout.endswith("; 2 of 2 objects complete\n")
    assert set(json.loads(built.run("-m", "dvc", "status", "--json").stdout)) <= OBSERVED


def test_object_file_answers(built):
    cube = ObjectFile.load(built.root / "build/cube/ObjectFile.safetensors")
    points = cube.sample_surface(3)
    assert cube.view([[2.5, 0, 0]], [0.5, 0, 0.8], resolution=32).shape == (1, 32, 32, 3)
    sounds = cube.impact(points, np.eye(3))
    assert sounds.shape == (3, 32000)
    assert np.abs(sounds).max() > 0
    assert cube.touch(points, depth=0.001).shape == (3, 160, 120, 3)


def test_visual_mesh_surface_and_object_file_share_a_frame(built):
    folder = built.root / "build/bell"
    visual = load_mesh(folder / "visual.glb", up="y")
    vertices, faces = read_surface(folder / "surface.ply")
    apart = np.sqrt(igl.point_mesh_squared_distance(visual.vertices, vertices, faces)[0])
    assert apart.max() < 1e-4
    bell = ObjectFile.load(folder / "ObjectFile.safetensors")
    apart = np.sqrt(igl.point_mesh_squared_distance(bell.surface.vertices, vertices, faces)[0])
    assert apart.max() < bell.surface.grid.spacing
    # And in the picture: object pixels of the ground truth are object pixels of the answer.
    with np.load(folder / "views/test.npz", allow_pickle=False) as views:
        rgba, pose, light = views["rgba"][0], views["camera_to_world"][0], views["light"][0]
        intrinsics = Intrinsics(*rgba.shape[:2], float(views["focal"]))
    drawn = draw(bell.surface, lambda s, *_: torch.zeros(len(s.points), 3), pose, light, intrinsics)
    assert np.abs(drawn.rgba[..., 3] - rgba[..., 3]).mean() < 0.02


def test_a_material_that_no_object_uses_reruns_nothing(built):
    olive = (ROOT / "objectfolder/base/materials/wood.yaml").read_text()
    new = [
        built.root / f"{folder}/olive_wood.yaml" for folder in ("materials", "objectfolder/base/materials")
    ]
    for path in new:
        path.write_text(olive)
    assert built.build() == {"hash_code"}
    for path in new:
        path.unlink()


@pytest.mark.slow
def test_a_material_of_ones_own_reruns_the_objects_that_name_it(built):
    own, wood = built.root / "materials/olive_wood.yaml", ROOT / "objectfolder/base/materials/wood.yaml"
    audio = {f"{stage}@cube" for stage in ("modal", "radiation", "train_audio", "pack")}
    own.write_text(wood.read_text())
    with built.edit() as values:
        values["objects"]["cube"]["material"] = "materials/olive_wood.yaml"
    assert audio < built.build()
    own.write_text(own.read_text().replace("density: 750.0", "density: 990.0").replace("0.6 ", "0.7 "))
    assert built.build("pack@cube", "pack@bell") == {"hash_code", *audio}
    header = ObjectFile.load(built.root / "build/cube/ObjectFile.safetensors").header
    assert header["material"] == "olive_wood"
    assert (header["material_properties"]["density"], header["material_properties"]["friction"]) == (990, 0.7)
    assert read_json(Build("cube", built.root).modal)["reused"]
    with built.edit() as values:
        values["objects"]["cube"]["material"] = "wood"
    assert not built.build() - {"hash_code"}  # restored


def test_a_mass_is_packed_and_nothing_is_solved_or_trained_again(built):
    path = built.root / "build/cube/ObjectFile.safetensors"
    before, params_text = ObjectFile.load(path), (built.root / "params.yaml").read_text()
    packed = path.read_bytes()
    with built.edit() as values:
        values["objects"]["cube"]["mass"] = 1.5
    try:
        assert built.build("evaluate@cube", "evaluate@bell") == {"hash_code", "pack@cube", "evaluate@cube"}
        weighed = ObjectFile.load(path)
        assert weighed.header == before.header | {"mass": 1.5}
        assert {n: t.tobytes() for n, t in weighed.tensors.items()} == {
            n: t.tobytes() for n, t in before.tensors.items()
        }
        with built.edit() as values:
            values["objects"]["cube"]["mass"] = 900.0
        failed = built.cli("build", "pack@cube", ok=False)
        assert "expected 1 to 25,000; give kilograms: 0.9 for 900 g" in failed.stdout + failed.stderr
    finally:
        (built.root / "params.yaml").write_text(params_text)
        assert not built.build() - {"hash_code"}  # restored
    assert path.read_bytes() == packed


@pytest.mark.slow
def test_a_smaller_object_is_not_solved_again(built):
    """Its modes are those of the solve, scaled; without the solve's file they are found anew."""
    build = Build("cube", built.root)
    before = build.modes.read_bytes()
    build.solved_modes.unlink()  # may be that of another test's material
    built.run("-m", "stages.modal", "cube")
    assert not read_json(build.modal)["reused"]
    solved = build.solved_modes.read_bytes()
    assert solved == build.modes.read_bytes() == before
    with built.edit() as values:
        values["objects"]["cube"]["scale"] = 0.15
    try:
        assert "modal@cube" in built.build("modal@cube")
        assert read_json(build.modal)["reused"]
        reused = read_npz(build.modes)
        assert build.solved_modes.read_bytes() == solved
        build.solved_modes.unlink()
        built.run("-m", "stages.modal", "cube")
        assert not read_json(build.modal)["reused"]
        fresh = read_npz(build.modes)
        assert len(fresh["damping"]) > 0
        for name in ("points", "split", "truncated"):
            np.testing.assert_array_equal(reused[name], fresh[name])
        for name in ("eigenvalues", "damping", "damped_frequency", "shapes", "band_hz"):
            np.testing.assert_allclose(
                reused[name], fresh[name], rtol=1e-6, atol=1e-6 * np.abs(fresh[name]).max()
            )
    finally:
        with built.edit() as values:
            values["objects"]["cube"]["scale"] = 0.16
        build.solved_modes.unlink(missing_ok=True)
        build.solved_modes.write_bytes(solved)
    built.build("cube")
    assert build.modes.read_bytes() == before


def test_an_object_whose_frequencies_stay_uncertain_is_packed_with_a_mark(built, caplog):
    build = Build("bell", built.root)
    coarse = {"resolutions": [8], "subdivisions": 4, "max_degrees_of_freedom": 20000, "max_error": 0.5}
    with built.edited(modal={"fine": coarse, "allow_uncertain": False}):
        summary = built.cli("build", "bell", "-j", "2").stdout
        modal, marked = read_json(build.modal), ObjectFile.load(build.object_file)
        error = modal["frequency_uncertainty"]
        assert error > 0.3
        assert modal["uncertain"]
        audio = marked.header["audio"]
        assert (audio["uncertain"], audio["frequency_uncertainty"]) == (True, error)
        assert re.search(rf"warning: bell: .* {error:.0%} wrong.*the sound is marked uncertain", summary)
        assert read_json(build.metrics)["audio"]["uncertain"]
        assert ", uncertain" in summary  # beside its scores
        for _ in range(2):
            marked.impact(marked.sample_surface(1), [0, 0, 1], duration=0.1)
        assert (
            caplog.text.count(
                f"bell: its sound is marked uncertain: its lowest frequencies may be {error:.0%}"
            )
            == 1
        )
        modes, tensors = build.modes.read_bytes(), dict(marked.tensors)
    with built.edited(modal={"fine": coarse}):  # whose error the tiny workspace accepts
        for stage in ("modal", "pack"):
            built.run("-m", f"stages.{stage}", "bell")
        assert build.modes.read_bytes() == modes
        assert read_json(build.modal) == {k: v for k, v in modal.items() if k != "uncertain"}
        accepted = ObjectFile.load(build.object_file)
        assert accepted.header["audio"] == {k: v for k, v in audio.items() if k != "uncertain"}
        for name, tensor in accepted.tensors.items():
            np.testing.assert_array_equal(tensor, tensors[name])
    built.build("bell")
    assert read_json(build.modal)["frequency_uncertainty"] < 0.3  # restored


@pytest.mark.slow
def test_the_papers_audio_net_is_a_choice(built):
    with built.edited(train_audio={"net": "spectrogram"}):
        assert built.build("bell") == {f"{stage}@bell" for stage in ("train_audio", "pack", "evaluate")}
        bell = ObjectFile.load(built.root / "build/bell/ObjectFile.safetensors")
        assert bell.header["audio"]["kind"] == "turned_spectrogram"
        assert bell.impact(bell.sample_surface(1), [0, 0, 1]).shape == (1, 32000)
        audio = json.loads((built.root / "metrics/bell.json").read_text())["audio"]
        assert audio["psnr"] > audio["baseline_silence"] - 1  # an untrained net is silent
        assert "spectrogram" in built.cli("info", "build/bell/ObjectFile.safetensors").stdout
    assert built.build() == set()  # restored


@pytest.mark.slow
def test_the_papers_vision_net_is_a_choice(built):
    views = {"tile": None, "train": 6, "val": 2}
    with built.edited(train_vision={"net": "osf"}, render_views=views):
        assert built.build("bell") == {
            f"{stage}@bell" for stage in ("render_views", "train_vision", "pack", "evaluate")
        }
        bell = ObjectFile.load(built.root / "build/bell/ObjectFile.safetensors")
        assert bell.header["vision"]["kind"] == "osf_hull"
        assert bell.view([2.5, 0, 0], [0.5, 0, 0.8], resolution=16).shape == (1, 16, 16, 3)
        scores = json.loads((built.root / "metrics/bell.json").read_text())["vision"]
        assert scores["psnr"] > scores["baseline_white"]
        trained = (built.root / "build/bell/vision.safetensors").read_bytes()
        built.run("-m", "stages.train_vision", "bell")
        assert (built.root / "build/bell/vision.safetensors").read_bytes() == trained
        assert "osf" in built.cli("info", "build/bell/ObjectFile.safetensors").stdout
    assert built.build() == set()  # restored


@pytest.mark.slow
def test_the_papers_touch_net_on_the_papers_images_is_a_choice(built):
    with built.edit() as values:
        before = values["sensor"], dict(values["render_touch"])
        values["sensor"] = "tacto_digit"
        values["render_touch"] |= {"renderer": "tacto", "depth": 0.001, "angle": 0.0}
        values["train_touch"]["net"] = "image"
    lane = ("render_touch", "train_touch", "pack", "evaluate")
    assert built.build("bell") == {f"{stage}@bell" for stage in lane}
    bell = ObjectFile.load(built.root / "build/bell/ObjectFile.safetensors")
    assert bell.header["touch"]["kind"] == "image"
    points = bell.sample_surface(3)
    assert bell.touch(points, depth=0.001).shape == (3, 160, 120, 3)
    refused(r"depth: row 0 is 0\.002; .* trained at depth 0\.001 m", bell.touch, points, depth=0.002)
    for question in (bell.press, partial(bell.touch, sensor="digit")):
        refused("bell: its touch net stores images", question, points)
    scores = json.loads((built.root / "metrics/bell.json").read_text())["touch"]
    assert "force_error" not in scores
    assert "image, sensor tacto_digit" in built.cli("info", "build/bell/ObjectFile.safetensors").stdout
    trained = (built.root / "build/bell/touch.safetensors").read_bytes()
    built.run("-m", "stages.train_touch", "bell")
    assert (built.root / "build/bell/touch.safetensors").read_bytes() == trained
    with built.edit() as values:
        values["train_touch"]["net"] = "geometric"
    assert built.build("bell") == {f"{stage}@bell" for stage in lane[1:]}
    bell = ObjectFile.load(built.root / "build/bell/ObjectFile.safetensors")
    assert bell.header["touch"]["net"]["renderer"] == "tacto"
    with built.edit() as values:
        values["sensor"], values["render_touch"] = before
    assert built.build() == set()  # restored


@pytest.mark.parametrize("stage", [*LANES, *NETS, "observe"])
def test_stage_gives_the_same_bytes_again_from_what_it_declares_alone(
    built, stage, tmp_path, other_fork_server
):
    if stage == "observe":
        assert built.build("observe@cube") <= {"observe@cube"}
    locked = YAML(typ="safe").load((built.root / "dvc.lock").read_text())["stages"][f"{stage}@cube"]
    deps = [d["path"] for d in locked["deps"]]
    lists = [(built.root / dep).read_text() for dep in deps if dep.startswith("build/.code/")]
    code = [line.split()[1] for text in lists for line in text.splitlines()]
    for dependency in ["params.yaml", *code, *deps]:
        source, copy = built.root / dependency, tmp_path / dependency
        copy.parent.mkdir(parents=True, exist_ok=True)
        if source.is_dir():
            shutil.copytree(source, copy)
        else:
            shutil.copy(source, copy)
    Workspace(tmp_path, other_fork_server).run("-m", f"stages.{stage}", "cube")
    for out in locked["outs"]:
        path = Path(out["path"])
        files = [p.relative_to(built.root) for p in (built.root / path).rglob("*") if p.is_file()]
        for file in files or [path]:
            assert (tmp_path / file).read_bytes() == (built.root / file).read_bytes(), file


def test_generated_mesh_is_the_same_bytes_twice(built, other_fork_server):
    path = built.root / "data/objects/bell/mesh.glb"
    before = path.read_bytes()
    Workspace(built.root, other_fork_server).run("-m", "stages.generate", "bell")
    assert path.read_bytes() == before


@pytest.mark.slow  # tests/report/test_inspection.py has the cheap ones
def test_inspect(built, opengl):
    stages = ("voxelize", "modal", "pack", "evaluate")
    for stage in stages:
        built.cli("inspect", f"{stage}@cube")
    assert "build" in built.cli("inspect", "modal@nothing", ok=False).stderr


@pytest.mark.slow
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
def test_an_interrupted_training_leaves_nothing_and_restarts_to_the_same_bytes(built, how):
    build = Build("cube", built.root)
    outputs = (build.net("vision"), build.curve("vision"))
    before = {path: path.read_bytes() for path in outputs}
    for path in outputs:
        path.unlink()
    files = set(build.dir.rglob("*"))
    with built.edit() as values:
        steps = values["train_vision"]["steps"]
        values["train_vision"]["steps"] = 4000
    try:
        command = [sys.executable, "-m", "stages.train_vision", "cube"]
        training = subprocess.Popen(
            command, cwd=built.root, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
        )
        assert training.stdout is not None
        assert b"step" in training.stdout.readline()
        training.send_signal(how)
        training.communicate(timeout=60)
        assert training.returncode != 0
        assert set(build.dir.rglob("*")) == files
    finally:
        with built.edit() as values:
            values["train_vision"]["steps"] = steps
        built.run("-m", "stages.train_vision", "cube")
    assert {path: path.read_bytes() for path in outputs} == before


def test_unwritable_build_directory_is_said_before_anything_runs(workspace):
    (workspace.root / "build").write_text("a file where the folder should be")
    done = workspace.cli("build", ok=False)
    assert done.returncode == 1
    assert "cannot write build" in done.stderr
    assert not (workspace.root / "dvc.lock").exists()


@pytest.mark.slow
def test_benchmarks_are_stages_over_all_objects(built):
    """Which splits run is a parameter; they follow from the observations of all objects."""
    with built.edited(benchmarks={"recognize": ["seen"]}):
        assert built.build() - OBSERVED == {"recognize@seen"}
        folder = Benchmarks(built.root / "benchmarks")
        scores = read_json(folder.result("recognize", "seen"))
        assert scores["objects"] == 2
        assert scores["VAT"]["accuracy"] <= 1
        before = {path: path.read_bytes() for path in folder.dir.glob("*_seen*")}
        assert len(before) == 3  # scores, curves and a figure
        assert built.build() == set()
        shown = built.run("-m", "dvc", "metrics", "show", "benchmarks/recognize_seen.json").stdout
        assert "VAT.accuracy" in shown
        built.run("-m", "stages.recognize", "seen")
        assert {path: path.read_bytes() for path in before} == before
        shown = built.cli("status", "--check", "recognize").stdout
        assert all(address in shown for address in ("recognize@seen", "observe@bell", "observe@cube"))
        assert "nothing to remove" in built.cli("prune", "--dry-run").stdout


@pytest.mark.slow
def test_a_trained_reconstructor_is_an_output(built):
    with built.edited(benchmarks={"reconstruct": ["seen"]}):
        assert built.build() - OBSERVED == {"reconstruct@seen"}
        folder = Benchmarks(built.root / "benchmarks")
        assert folder.sheet("reconstruct", "seen").stat().st_size > 1000
        assert load_model(folder.model("reconstruct", "seen")).setup.modalities == ("vision",)
        assert built.build() == set()


@pytest.mark.slow
def test_what_robots_do_are_stages_of_the_objects_that_are_named(built):
    with built.edited(benchmarks={stage: ["bell"] for stage in ROBOT_STAGES}):
        assert built.build() == {f"{stage}@bell" for stage in ROBOT_STAGES}
        folder = Benchmarks(built.root / "benchmarks")
        assert Grasps({"bell": folder.grasps("bell")}).has_explicit
        assert built.build() == set()
        results = [*folder.dir.glob("*_bell*"), Build("bell", built.root).hulls]
        before = {path: path.read_bytes() for path in results}
        for stage in ROBOT_STAGES:
            built.run("-m", f"stages.{stage}", "bell")
        assert {path: path.read_bytes() for path in results} == before
