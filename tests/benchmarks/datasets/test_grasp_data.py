import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from brick import felt_by, with_images
from folders import contents
from refusals import refused

from objectfolder.base.errors import ObjectFolderError
from objectfolder.benchmarks.datasets import grasp_data
from objectfolder.benchmarks.datasets.grasps import ARRAYS, Grasps
from objectfolder.objectfile.file import ObjectFile
from objectfolder.sim.body import rigid_body, rotation
from objectfolder.sim.fingers import Presses
from objectfolder.sim.grasp_scene import GraspScene, Physics, lowest_hand
from objectfolder.sim.hulls import convex_hulls

WANTED = grasp_data.GraspDataConfig(grasps=10, perturbations=1, image=24, touch=(16, 12), timestep=0.002)


@pytest.fixture(scope="module")
def body(brick):
    return rigid_body(brick, convex_hulls(brick.to_mesh()))


@pytest.fixture(scope="module", autouse=True)
def small_batches():
    """Two batches for ten grasps."""
    before, grasp_data.BATCH = grasp_data.BATCH, 6
    yield
    grasp_data.BATCH = before


@pytest.fixture(scope="module")
def surface(brick):
    return brick.surface.vertices, brick.surface.faces


@pytest.fixture(scope="module")
def collected(brick, body, surface, tmp_path_factory):
    folder = tmp_path_factory.mktemp("grasps") / "brick"
    grasp_data.collect_grasps(brick, body, WANTED, 0, folder, surface)
    return folder


def test_what_is_collected(brick, collected):
    grasps = Grasps({"brick": collected})
    assert grasps.count == 10
    assert grasps.has_explicit
    assert grasps.shape("image") == (24, 24, 3)
    assert grasps.shape("touch") == (2, 16, 12, 3)
    rows = np.arange(10)
    width, soft, force = (grasps.read(name, rows) for name in ("width", "soft", "force"))
    # It is 3, 6 and 10 cm thick; jaws may close on a corner of it.
    assert ((width > 0.028) & (width < 0.11)).all()
    assert set(np.round(2 * soft).astype(int)) <= {0, 1, 2}
    assert ((force > 0.5 * grasp_data.FORCES[0]) & (force < 1.5 * grasp_data.FORCES[1])).all()
    offset = grasps.read("offset", rows)
    assert np.linalg.norm(offset, axis=1).max() < 0.06
    # The truth here is the stored surface itself, on which both then agree.
    touch, explicit = (grasps.read(name, rows).astype(int) for name in ("touch", "explicit"))
    assert np.abs(touch - explicit).mean() < 0.5
    record = json.loads((collected / "record.json").read_text())
    assert record["attempts"]["drawn"] >= record["attempts"]["free"] >= record["attempts"]["touched"] >= 10
    assert record["success_rate"] == pytest.approx(grasps.success.mean())
    assert {path.stem for path in collected.glob("*.npy")} == set(ARRAYS)


def test_explicit_touches_have_the_stored_background(brick, surface):
    photographed = felt_by(brick, "digit_real")
    truth = grasp_data._truth(photographed, surface)
    pressed = Presses(np.array([[0, 0.03, 0]]), np.array([[0.0, 1, 0]]), np.array([[0.0, 0, 1]]))
    assert np.array_equal(truth.tactile_images(pressed, np.zeros(1)), photographed.touch([[0, 0.03, 0]], 0.0))


def test_poses_are_enough_to_run_grasps_again(brick, body, collected):
    poses = np.load(collected / "poses.npz", allow_pickle=False)
    grasps = Grasps({"brick": collected})
    again = GraspScene(body).close(poses["start"], poses["hands"], poses["limits"])
    assert np.array_equal(again.objects, poses["objects"])
    assert again.width.astype(np.float32).tobytes() == grasps.read("width", np.arange(10)).tobytes()


def test_interrupted_and_threaded_collections_are_the_same(
    brick, body, surface, collected, tmp_path, monkeypatch
):
    folder = tmp_path / "brick"
    request = grasp_data.grasp_request(brick, body, WANTED, 0, surface)

    def stop(done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        grasp_data.collect_grasps(brick, body, WANTED, 0, folder, surface, report=stop)
    assert not (folder / "record.json").exists()
    assert not grasp_data.is_collected(request, folder)
    tried, first = [], grasp_data.label_grasps
    monkeypatch.setattr(grasp_data, "label_grasps", lambda *args: tried.append(0) or first(*args))
    grasp_data.collect_grasps(brick, body, WANTED, 0, folder, surface, threads=2)
    assert contents(folder) == contents(collected)
    assert grasp_data.is_collected(request, folder)
    grasp_data.collect_grasps(brick, body, WANTED, 0, folder, surface)
    assert len(tried) == 1  # of two batches the first was there
    shutil.copytree(collected, tmp_path / "copy")
    for damage in (lambda path: path.write_bytes(path.read_bytes()[:-1]), Path.unlink):
        damage(tmp_path / "copy" / "touch.npy")
        assert not grasp_data.is_collected(request, tmp_path / "copy")


def test_starts_are_free_and_forces_spread(body):
    scene = GraspScene(body)
    rests = scene.rests(np.random.default_rng(0), 8)
    attempts, drawn = grasp_data.draw_attempts(scene, rests, 40, np.random.default_rng(1))
    assert drawn >= 40
    assert scene.free(attempts.objects, attempts.hands).all()
    assert attempts.hands[:, 2].min() >= lowest_hand()
    assert grasp_data.FORCES[0] <= attempts.forces.min() < 3
    assert 15 < attempts.forces.max() <= grasp_data.FORCES[1]
    # All rest on the table, whichever way they are turned.
    points = body.hulls[0].vertices
    lowest = [(points @ rotation(pose[3:]).T + pose[:3])[:, 2].min() for pose in attempts.objects]
    assert np.abs(lowest).max() < 0.001


def without_touch(brick):
    return ObjectFile({name: value for name, value in brick.header.items() if name != "touch"}, brick.tensors)


@pytest.mark.parametrize(
    ("changed", "turned", "message"),
    [
        (
            without_touch,
            None,
            "the Object File holds no touch; grasps need geometry, vision and touch: leave",
        ),
        (lambda brick: felt_by(brick, "tacto_digit"), None, "the gel of sensor 'tacto_digit' is rigid and"),
        (lambda brick: brick, [2, 0, 1], "the true surface reaches .* another object or build"),
        (lambda brick: with_images(brick, 0.001, 0.0), [0, 1, 2], "its touch net stores a single press"),
    ],
    ids=["no touch", "rigid gel", "another surface", "a net of images"],
)
def test_what_cannot_be_grasped_is_refused(brick, body, surface, tmp_path, changed, turned, message):
    truth = None if turned is None else (surface[0][:, turned], surface[1])
    refused(f"brick: {message}", grasp_data.collect_grasps, changed(brick), body, WANTED, 0, tmp_path, truth)
    assert list(tmp_path.iterdir()) == []


def test_a_net_that_knows_no_turned_sensor_is_refused(brick, body, tmp_path, monkeypatch):
    monkeypatch.setattr("objectfolder.sim.fingers.DepthMapSense", type(brick.touch_sense))
    with pytest.raises(ObjectFolderError, match=r"brick: the touch net of an imported 2\.0 file cannot turn"):
        grasp_data.collect_grasps(brick, body, WANTED, 0, tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_what_is_flatter_than_pads_reach_is_said(brick, tmp_path):
    crumb = ObjectFile(brick.header | {"key": "crumb", "scale": 0.003}, brick.tensors)
    tiny = rigid_body(crumb, convex_hulls(crumb.to_mesh()))
    with pytest.raises(ObjectFolderError, match=r"crumb: both pads touch it in none of \d+ .* 4 mm over"):
        grasp_data.collect_grasps(crumb, tiny, WANTED, 0, tmp_path)


def test_another_request_is_another_collection(brick, body, surface, collected):
    vertices, faces = surface
    moved = replace(body, hulls=tuple(hull.copy().apply_scale(1.01) for hull in body.hulls))
    assert grasp_data.is_collected(grasp_data.grasp_request(brick, body, WANTED, 0, surface), collected)
    for other in (
        (moved, WANTED, 0, surface),
        (body, replace(WANTED, timestep=0.001), 0, surface),
        (body, WANTED, 1, surface),
        (body, WANTED, 0, None),
        (body, WANTED, 0, (vertices + 1e-5, faces)),
    ):
        assert not grasp_data.is_collected(grasp_data.grasp_request(brick, *other), collected)


def test_the_time_step_is_that_of_the_simulation(brick, body, tmp_path, monkeypatch):
    def scene(body, physics, threads):
        raise ObjectFolderError(repr(physics))

    monkeypatch.setattr(grasp_data, "GraspScene", scene)
    with pytest.raises(ObjectFolderError, match=re.escape(repr(Physics(timestep=0.001)))):
        grasp_data.collect_grasps(brick, body, replace(WANTED, timestep=0.001), 0, tmp_path)
