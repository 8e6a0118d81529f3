import mujoco
import numpy as np
import pytest
from refusals import refused

from objectfolder.sim.body import RigidBody, rotation, turn_poses
from objectfolder.sim.grasp_scene import LIFT, GraspScene, Physics, lowest_hand
from objectfolder.sim.gripper import SIDES, STROKE, add_gripper, hand_axes

GRAVITY = 9.81


@pytest.fixture(scope="module")
def scene(body):
    return GraspScene(body)


@pytest.fixture(scope="module")
def flat(scene):
    """At rest on its largest face, turned so that jaws close over its 6 cm."""
    rests = scene.rests(np.random.default_rng(0), 8)
    lowest = rests[[rests[:, 2].argmin()]]
    long = rotation(lowest[0, 3:])[:2, 0]
    return turn_poses(lowest, [np.pi / 2 - np.arctan2(long[1], long[0])], np.zeros((1, 2)))


def over(scene, y=0.0, yaw=0.0):
    return np.array([[0.0, y, lowest_hand(), yaw]])


def test_objects_come_to_rest_on_a_face(scene, body):
    rests = scene.rests(np.random.default_rng(1), 12)
    heights = np.ptp(body.bounds, axis=0) / 2
    assert np.abs(rests[:, 2, None] - heights).min(1).max() < 0.002
    assert np.allclose(np.linalg.norm(rests[:, 3:], axis=1), 1)


def test_a_firm_grasp_holds_and_a_weak_one_does_not(scene, flat, body):
    """Both pads carry the weight by friction: 2 mu F > m g, and more while the hand accelerates."""
    least = body.mass * GRAVITY / (2 * body.friction)
    done = scene.grasp(np.repeat(flat, 2, 0), np.repeat(over(scene), 2, 0), np.array([0.8, 2.5]) * least)
    assert done.touched.all()
    assert done.success.tolist() == [False, True]
    assert done.rise[1] == pytest.approx(LIFT, abs=0.005)
    assert done.rise[0] < LIFT / 2


def test_forces_and_contacts_of_the_pads(scene, flat):
    done = scene.grasp(flat, over(scene), np.array([20.0]))
    assert done.forces[0] == pytest.approx([20, 20], rel=0.05)
    assert done.width[0] == pytest.approx(0.06, abs=0.002)
    assert done.contacts[0, :, 0] == pytest.approx([0.03, -0.03], abs=0.0015)
    assert (np.abs(done.contacts[0, :, 1]) < 0.01).all()
    assert (done.contacts[0, :, 2] < 0.031).all()


def test_jaws_that_close_beside_the_object_touch_nothing(scene, flat):
    done = scene.grasp(flat, over(scene, y=0.07), np.array([20.0]))
    assert not done.touched.any()
    assert not done.success[0]
    assert done.rise[0] == pytest.approx(0, abs=1e-4)


def test_rows_do_not_depend_on_each_other_or_on_threads(scene, flat, body):
    hands = np.concatenate([over(scene, y, yaw) for y, yaw in ((0, 0), (0.03, 0.2), (-0.04, -0.3))])
    forces = np.array([5.0, 10.0, 3.0])
    objects = np.repeat(flat, 3, 0)
    together = GraspScene(body, threads=2).grasp(objects, hands, forces)
    for row in range(3):
        alone = scene.grasp(objects[[row]], hands[[row]], forces[[row]])
        for name, value in vars(alone).items():
            assert np.array_equal(value[0], getattr(together, name)[row]), name


def test_grasps_do_not_depend_on_their_place_on_the_table(scene, flat):
    """A rotated and shifted grasp has the same outcome, up to rounding."""
    here = scene.grasp(flat, over(scene, 0.01, 0.1), np.array([12.0]))
    objects = turn_poses(flat, [0.7], np.array([[0.2, -0.1]]))
    spin = np.array([[np.cos(0.7), -np.sin(0.7)], [np.sin(0.7), np.cos(0.7)]])
    hand = over(scene, 0.01, 0.1)
    hand[0, :2] = spin @ hand[0, :2] + [0.2, -0.1]
    hand[0, 3] += 0.7
    there = scene.grasp(objects, hand, np.array([12.0]))
    assert there.success == here.success
    assert there.width == pytest.approx(here.width, abs=1e-4)
    assert there.forces == pytest.approx(here.forces, rel=0.02)


def test_poses_at_which_the_gripper_collides_are_not_free(scene, flat):
    hands = np.concatenate([over(scene), over(scene, yaw=np.pi / 2), over(scene) - np.array([0, 0, 0.01, 0])])
    # Over its 6 cm; over its 10 cm, which the jaws just clear; through the table.
    assert scene.free(np.repeat(flat, 3, 0), hands).tolist() == [True, True, False]
    beside = over(scene) + np.array([0.045, 0, 0, 0])  # a finger would come down on the brick
    assert scene.free(flat, beside).tolist() == [False]


def test_frames_of_a_grasp_go_through_all_phases(scene, flat):
    frames = scene.watch(flat[0], over(scene)[0], 20.0, 0.1)
    phases = list(dict.fromkeys(frame.phase for frame in frames))
    assert phases == ["reach", "close", "lift", "hold", "put back", "release"]
    lifted = [frame.place[2] for frame in frames if frame.phase == "hold"]
    assert min(lifted) > flat[0, 2] + 0.9 * LIFT
    assert frames[-1].place[2] == pytest.approx(flat[0, 2], abs=0.001)
    assert frames[-1].width > 0.9 * STROKE


def test_too_large_an_object_is_refused(body):
    scaled = [hull.copy().apply_scale(8) for hull in body.hulls]
    big = RigidBody("crate", tuple(scaled), 1.0, body.centre, body.inertia, 0.5, 8 * body.bounds)
    refused(r"crate is too large for the gripper: .* 2\d\d mm .* 110 mm", GraspScene, big)


def test_jaws_are_coupled_and_open_as_far_as_a_wsg_50():
    spec = mujoco.MjSpec()
    spec.worldbody.add_body(name="object").add_geom(
        type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.001, 0, 0], pos=[1, 1, 1]
    )
    add_gripper(spec, 0.5)
    model = spec.compile()
    data = mujoco.MjData(model)
    data.ctrl[[model.actuator(side).id for side in SIDES]] = [STROKE, 0.0]  # one wants to open, one to close
    mujoco.mj_step(model, data, 500)
    left, right = (data.joint(side).qpos[0] for side in SIDES)
    assert left == pytest.approx(right, abs=0.002)
    assert STROKE == 0.11


def test_turned_poses():
    pose = np.array([[0.1, 0.0, 0.3, 1.0, 0, 0, 0]])
    moved = turn_poses(pose, [np.pi / 2], np.array([[1.0, 2.0]]))[0]
    assert moved[:3] == pytest.approx([1.0, 2.1, 0.3])
    assert rotation(moved[3:]) == pytest.approx(np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]]), abs=1e-12)
    assert hand_axes(np.array([[0, 0, 0, np.pi / 2]]))[0][:, 0] == pytest.approx([0, 1, 0])


def test_settings_of_contacts():
    option = Physics(timestep=0.004, cone="pyramidal", impratio=3).scene().option
    assert (option.timestep, option.cone, option.impratio) == (0.004, mujoco.mjtCone.mjCONE_PYRAMIDAL, 3)
