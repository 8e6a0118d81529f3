import json
import shutil
import subprocess

import mujoco
import numpy as np
import pytest
from refusals import refused
from test_hearing import scene

from objectfolder.cli import app
from objectfolder.sim.clip import SceneCamera, SceneView, default_view, simulate
from objectfolder.sim.export import write_mjcf
from objectfolder.sim.hearing import Hearing

ABOVE = SceneView(np.array([0.0, -0.001, 0.6]), np.array([0.0, 0.0, 0.0]), 30.0)


def test_a_take_has_all_pictures_and_all_sound(brick):
    model = scene([brick])
    data = mujoco.MjData(model)
    take = simulate(model, data, Hearing(model, [brick], "ear"), 0.3, 25)
    assert (len(take.states), len(take.sound)) == (8, 15360)
    assert take.sound.any()
    refused("hold no frame", simulate, model, data, Hearing(model, [brick], "ear"), 0.001, 25)


def test_an_object_is_drawn_where_it_is_and_throws_a_shadow(brick):
    """From above: the brick covers its outline, moves by its motion, and darkens the table beside it."""
    model = scene([brick])
    data = mujoco.MjData(model)
    camera = SceneCamera(model, {"brick": brick}, ABOVE, 120, 120)
    data.qpos[:3] = [0, 0, -1]  # under the table
    mujoco.mj_kinematics(model, data)
    empty = camera.picture(data).astype(int)

    def shown(x):
        data.qpos[:] = [x, 0, 0.015, 1, 0, 0, 0]
        mujoco.mj_kinematics(model, data)
        changed = camera.picture(data) - empty
        ratio = changed.sum(2) / empty.sum(2)
        shadow = (changed != 0).any(2) & (abs(changed - ratio[..., None] * empty).max(2) < 2) & (ratio < -0.3)
        covered = (changed != 0).any(2) & ~shadow
        return covered, shadow, np.nonzero(covered)[1].mean()

    covered, shadow, middle = shown(0.0)
    pixel = 2 * np.tan(np.radians(15)) * (0.6 - 0.03) / 120  # of the upper face
    assert covered.sum() * pixel**2 == pytest.approx(0.1 * 0.06, rel=0.1)
    assert abs(middle - 59.5) < 1
    assert shadow.sum() > 50
    assert shown(0.05)[2] - middle == pytest.approx(0.05 / pixel, abs=1.5)


def test_the_default_view_sees_the_objects(brick):
    model = scene([brick])
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    view = default_view(model, data, {"brick": brick})
    picture = SceneCamera(model, {"brick": brick}, view, 60, 80).picture(data)
    model.geom_group[model.geom_bodyid == 1] = 5
    empty = SceneCamera(model, {}, view, 60, 80).picture(data)
    assert (picture != empty).any(2).mean() > 0.02


def test_simulate_says_what_it_needs(brick, tmp_path, monkeypatch):
    monkeypatch.setattr("shutil.which", lambda program: program)  # whether it is installed or not
    path = tmp_path / "scene.xml"
    cup = "<worldbody><body name='cup'><geom size='.1'/></body></worldbody>"
    for content, out, message in (
        (cup, "a.mp4", "no body is named bell or die or mug"),
        ("<nonsense/>", "a.mp4", "scene.xml: MuJoCo cannot read it"),
        (cup, "a.gif", r"ends in \.mp4"),
    ):
        path.write_text(f"<mujoco>{content}</mujoco>")
        refused(message, app, ["simulate", str(path), "--out", str(tmp_path / out)], standalone_mode=False)


@pytest.mark.skipif(shutil.which("ffprobe") is None, reason="needs the program ffmpeg")
def test_simulate_films_an_attached_object_with_its_sound(brick, brick_path, tmp_path):
    write_mjcf(brick, tmp_path, hulls=[brick.to_mesh().convex_hull])
    path, out = tmp_path / "scene.xml", tmp_path / "a.mp4"
    path.write_text(
        "<mujoco><asset><model name='brick' file='brick/brick.xml'/></asset><worldbody>"
        "<geom type='plane' size='1 1 .1'/><frame pos='0 0 .1' euler='20 10 0'>"
        "<attach model='brick' body='brick' prefix='one/'/></frame></worldbody></mujoco>"
    )
    arguments = [path, brick_path, "--out", out, "--seconds", 0.4, "--rate", 10, "--size", 64, 48]
    app(["simulate", *map(str, arguments)], standalone_mode=False)
    probe = ["ffprobe", "-v", "error", "-show_streams", "-of", "json", str(out)]
    streams = json.loads(subprocess.check_output(probe))["streams"]
    picture, track = sorted(streams, key=lambda stream: stream["codec_type"], reverse=True)
    assert (picture["width"], picture["height"], picture["nb_frames"]) == (64, 48, "4")
    assert track["codec_name"] == "aac"


def test_a_scenes_camera_is_followed_as_it_turns_and_moves(brick):
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.2, 0.05, 0.01], rgba=[1, 0, 0, 1])
    paint = spec.add_material(name="paint", rgba=[0, 0, 1, 1])
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.02, 0.02, 0.02], pos=[0.3, 0, 0], material=paint.name
    )
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.3, 0, 0], group=3)  # for collisions
    body = spec.worldbody.add_body(name="arm", pos=[0, 0, 1])
    body.add_joint(type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 0, 1])
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.001, 0, 0], pos=[0, 0, 1], mass=1)
    body.add_camera(fovy=45)  # straight down, as MuJoCo's cameras are
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    camera = SceneCamera(model, {}, default_view(model, data, {}), 41, 41)
    level = camera.picture(data).astype(int)
    data.qpos[0] = np.pi / 2
    mujoco.mj_forward(model, data)
    turned = camera.picture(data)
    assert (level[20, 20] == level[20, 12]).all()
    assert level[20, 20, 0] > 2 * level[20, 20, 1]
    assert (level[20] != 237).any(1).sum() > 2 * (level[:, 20] != 237).any(1).sum()
    blue = level[..., 2] > 2 * level[..., 0]
    assert 0 < blue.sum() < 20
    assert (np.abs(np.rot90(level, -1) - turned) > 2).any(2).sum() < 5  # of 1,681, at edges
