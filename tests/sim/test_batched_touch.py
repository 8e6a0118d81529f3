"""Batches of touches agree with single ones, on every path that a device can take."""

from dataclasses import replace
from importlib.util import find_spec

import mujoco
import numpy as np
import pytest
import torch
from pretend_device import pretend_device

from objectfolder import ObjectFile
from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.metrics import psnr
from objectfolder.sim.batched_touch import BatchedTouch, relative_poses
from objectfolder.sim.body import add_body, rigid_body
from objectfolder.touch import batched_rays, senses
from objectfolder.touch.batched_gel import GelBatch
from objectfolder.touch.batched_rays import EmbreeHeights, WarpHeights, require_warp
from objectfolder.touch.batched_slip import SlipBatch
from objectfolder.touch.contact import sensor_frames
from objectfolder.touch.optics import Optics
from objectfolder.touch.profiles import load_profile
from objectfolder.touch.simulate import press

COUNT = 8
NAMES = ("mug", "die")


@pytest.fixture(scope="module", autouse=True)
def _one_thread():
    torch.set_num_threads(1)


@pytest.fixture(scope="module")
def files():
    return [ObjectFile.sample(name) for name in NAMES]


@pytest.fixture(scope="module")
def touch(files):
    return BatchedTouch(files, "digit")


@pytest.fixture(scope="module")
def contacts(files):
    """Contacts of both objects in turn; points on the surface, of which some are in narrow places."""
    rng = np.random.default_rng(4)
    index = np.arange(COUNT) % 2
    points, normals = np.empty((2, COUNT, 3))
    for number, file in enumerate(files):
        points[index == number] = file.sample_surface(COUNT // 2)
        normals[index == number] = file.contact_normals(points[index == number])
    return {
        "object_index": index,
        "points": points,
        "normals": normals,
        "angle": rng.uniform(0, 6, COUNT),
        "depth": rng.uniform(0.0005, 0.002, COUNT),
        "shear": rng.uniform(-4e-4, 4e-4, (COUNT, 2)),
        "twist": rng.uniform(-0.1, 0.1, COUNT),
    }


@pytest.fixture(scope="module")
def singles(files, contacts):
    """What `ObjectFile.press` says of each contact alone."""
    names = ("points", "depth", "angle", "shear", "twist")
    return [
        files[number].press(**{name: contacts[name][k : k + 1] for name in names}, tilt=0.0, sensor="digit")
        for k, number in enumerate(contacts["object_index"])
    ]


@pytest.fixture(scope="module")
def felt(touch, contacts):
    return touch.press(**contacts)


def decibels(images, others):
    error = ((images.astype(float) - others.astype(float)) ** 2).mean((1, 2, 3))
    return 10 * np.log10(255**2 / np.maximum(error, 1e-9))


def require_agreement(found, singles):
    def one(name):
        return np.concatenate([getattr(single, name) for single in singles])

    assert decibels(found.images.numpy(), one("images")).min() > 70
    np.testing.assert_allclose(found.wrench[:, 0], one("force"), rtol=1e-4)
    np.testing.assert_allclose(found.wrench[:, 1:3], one("shear_force"), atol=2e-4 * one("force").max())
    np.testing.assert_allclose(found.wrench[:, 3], one("torque"), atol=1e-5)
    np.testing.assert_allclose(found.marker_flow, one("marker_flow"), atol=0.01)
    np.testing.assert_allclose(found.slipping, one("slipping"), atol=0.01)
    np.testing.assert_allclose(found.area, one("area"), rtol=1e-3, atol=1e-9)
    np.testing.assert_allclose(found.obstructed, one("obstructed"), rtol=1e-6)
    np.testing.assert_allclose(found.displacement, one("displacement"), atol=2e-6)
    np.testing.assert_allclose(found.height, one("height"), atol=2e-6)
    assert found.residual.max() <= 1


def test_a_batch_of_two_objects_agrees_with_single_presses(felt, singles):
    assert max(single.force.max() for single in singles) > 1
    require_agreement(felt, singles)


def test_the_steps_that_a_gpu_takes_suffice(files, contacts, singles):
    """On a GPU all rows take the same number of steps, without a look at them."""
    touch = BatchedTouch(files, "digit")
    touch._presses.gel.early = False
    require_agreement(touch.press(**contacts), singles)


def test_gels_and_images_are_computed_on_their_device(touch, felt, contacts):
    """As on a CPU; `pretend_device` refuses tensors of two devices in one operation."""
    shear, twist = (torch.from_numpy(contacts[name]).float() for name in ("shear", "twist"))
    height = touch.press(**{k: v for k, v in contacts.items() if k not in ("shear", "twist")}).height
    with pretend_device() as device:
        gel, on = GelBatch(touch.profile, torch.device(device)), {"device": device}
        moved, pressure, residual = gel.press(height.to(device))
        friction = SlipBatch(gel)
        slips = friction.slip(pressure, shear.to(device), twist.to(device), torch.full((COUNT,), 0.5, **on))
        after = friction.drag(height.to(device), pressure, slips.dragged, shear.to(device), twist.to(device))
        flow, wrench = gel.flow(slips.sideways, moved), gel.wrench(pressure, slips.traction)
        images = Optics(touch.profile, device).render(after[1])
        assert {v.device.type for v in (*after, flow, wrench, images, residual)} == {device}
        assert decibels(images.cpu().numpy(), felt.images.numpy()).min() > 60
        assert float((wrench.cpu()[:, 0] - felt.wrench[:, 0]).abs().max()) < 1e-4


def test_a_pose_is_the_same_as_a_point_and_a_normal(touch, contacts, felt):
    pose = np.tile(np.eye(4), (COUNT, 1, 1))
    pose[:, :3, :3] = sensor_frames(contacts["normals"], contacts["angle"])
    pose[:, :3, 3] = contacts["points"]
    rest = {name: contacts[name] for name in ("object_index", "depth", "shear", "twist")}
    again = touch.press(pose=pose, **rest)
    assert decibels(again.images.numpy(), felt.images.numpy()).min() > 80


def test_a_row_does_not_depend_on_the_others(touch, contacts, felt):
    alone = touch.press(**{name: values[3:4] for name, values in contacts.items()})
    assert decibels(alone.images.numpy(), felt.images[3:4].numpy()).min() > 80
    np.testing.assert_allclose(alone.wrench, felt.wrench[3:4], rtol=1e-4, atol=1e-5)


def test_a_warm_start_leads_to_the_same_contact(touch, contacts, felt):
    shallower = touch.press(**contacts | {"depth": contacts["depth"] - 1e-4})
    warm = touch.press(**contacts, start=shallower.pressed)
    np.testing.assert_allclose(warm.wrench, felt.wrench, rtol=0.01, atol=0.002 * felt.wrench.max())
    assert decibels(warm.images.numpy(), felt.images.numpy()).min() > 50


def test_objects_of_other_sizes_are_pressed_as_scaled(touch, files, contacts):
    scale = np.array([file.scale for file in files])[contacts["object_index"]] * np.linspace(0.8, 1.2, COUNT)
    points = contacts["points"] * np.linspace(0.8, 1.2, COUNT)[:, None]
    kept = {name: contacts[name] for name in ("object_index", "normals", "angle", "depth")}
    found = touch.press(**kept, points=points, scale=scale, fitted=False)
    for k, number in enumerate(contacts["object_index"]):
        pose = (of[k : k + 1] for of in (points, kept["normals"], kept["angle"], kept["depth"]))
        one = press(files[number].surface.caster, *pose, touch.profile, scale[k])
        np.testing.assert_allclose(found.wrench[k, 0], one.force[0], rtol=1e-4)
        np.testing.assert_allclose(found.height[k], one.height[0], atol=1e-7)


def test_torques_are_those_of_the_pressure_about_the_apex(touch, contacts):
    still = {name: contacts[name] for name in ("object_index", "points", "normals", "angle", "depth")}
    found = touch.press(**still)
    profile = replace(touch.profile, gel_curvature=0.0)
    pitch = profile.pixel_pitch
    right = (np.arange(profile.width) - (profile.width - 1) / 2) * pitch
    up = -(np.arange(profile.height) - (profile.height - 1) / 2) * pitch
    force = GelBatch(profile, torch.device("cpu")).wrench(found.pressure, None)
    load = found.pressure.numpy().astype(float) * pitch**2
    np.testing.assert_allclose(force[:, 4], (load * up[:, None]).sum((1, 2)), rtol=1e-3, atol=1e-6)
    np.testing.assert_allclose(force[:, 5], -(load * right).sum((1, 2)), rtol=1e-3, atol=1e-6)


def test_a_rigid_gel_takes_the_imprint_and_cannot_be_sheared(files, contacts):
    touch = BatchedTouch(files, "tacto_digit")
    still = {name: contacts[name] for name in ("object_index", "points", "normals", "angle", "depth")}
    found = touch.press(**still)
    assert torch.equal(found.displacement, found.height.clamp(min=0))
    assert found.wrench.isnan().all()
    assert (found.area > 0).any()
    with pytest.raises(ObjectFolderError, match="rigid and cannot be sheared"):
        touch.press(**still, twist=0.1)


@pytest.mark.skipif(find_spec("warp") is None, reason="the extra batch is not installed")
def test_rays_of_warp_meet_the_surface_where_those_of_embree_do(files, contacts):
    surfaces, digit = [file.surface for file in files], load_profile("digit")
    index, points, angle = (contacts[name] for name in ("object_index", "points", "angle"))
    frames = sensor_frames(contacts["normals"], angle)
    # Beside usual contacts: in the wall, in the cup, and with the camera inside the solid.
    points = np.concatenate([points, points[:4] - 0.004 * contacts["normals"][:4], np.zeros((2, 3))])
    frames, index = (
        np.concatenate([frames, frames[:4], frames[:2]]),
        np.concatenate([index, index[:4], [0, 1]]),
    )
    scale = np.array([file.scale for file in files])[index]
    depth = np.full(len(index), 0.001)
    given = [torch.from_numpy(v) for v in (index, points, frames, depth, scale)]
    height, obstructed = EmbreeHeights(surfaces, digit).cast_heights(*given)
    found, blocked = WarpHeights(surfaces, digit, torch.device("cpu")).cast_heights(*given)
    assert (obstructed > 0).sum() >= 4
    np.testing.assert_allclose(blocked, obstructed, atol=2e-4)
    assert ((found - height).abs() > 1e-6).double().mean() < 1e-4


def test_where_warp_has_no_rays_the_error_says_what_to_do(monkeypatch):
    monkeypatch.setattr(batched_rays, "find_spec", lambda name: None)
    with pytest.raises(ObjectFolderError, match=r"\[batch\]"):
        require_warp(torch.device("cuda"))
    with pytest.raises(ObjectFolderError, match=r"'mps'.* CUDA devices"):
        require_warp(torch.device("mps"))


BAD = {
    "object_index": (2, "contact 3: object_index is 2, expected 0 to 1"),
    "points": ([0.0, np.nan, 0.0], "contact 3: point is .*nan.* expected three finite"),
    "normals": ([0.0, 0.0, 2.0], "contact 3: pose .*not orthonormal"),
    "angle": (np.inf, "contact 3: pose .*not orthonormal"),
    "depth": (0.004, "contact 3: depth is 0.004 m, expected 0 to 0.003 m"),
    "shear": ([0.004, 0.0], "contact 3: shear is .* expected at most 0.003 m"),
    "twist": (4.0, "contact 3: twist is 4.0 rad"),
}


@pytest.mark.parametrize("name", BAD)
def test_an_error_names_the_row_and_the_value(name, touch, contacts):
    wrong, message = BAD[name]
    values = contacts[name].copy()
    values[3] = wrong
    with pytest.raises(ObjectFolderError, match=message):
        touch.press(**contacts | {name: values})


def test_a_pose_that_is_not_rigid_is_refused(touch):
    mirrored = np.diag([1.0, 1.0, -1.0, 1.0])
    for pose in (mirrored, 1.1 * np.eye(4), np.full((4, 4), np.nan)):
        with pytest.raises(ObjectFolderError, match="contact 0: p"):
            touch.press(0, pose)


def test_without_checks_a_bad_row_is_nan_and_others_do_not_notice(files, contacts, felt):
    touch = BatchedTouch(files, "digit", checks=False)
    for name, (wrong, _) in BAD.items():
        values = contacts[name].copy()
        values[3] = wrong
        found = touch.press(**contacts | {name: values})
        others = np.arange(COUNT) != 3
        assert found.wrench[3].isnan().all()
        assert found.height[3].isnan().all()
        assert torch.equal(found.images[3], touch.background)
        np.testing.assert_allclose(found.wrench[others], felt.wrench[others], rtol=1e-4, atol=1e-5)


def pressing(file):
    """A finger that slides along x into an object, which is fixed and turned about the vertical.

    The gel's apex is 1 mm in front of what collides, so that it is pressed in by this.
    """
    spec = mujoco.MjSpec()
    spec.option.gravity = [0, 0, 0]
    body = add_body(spec, rigid_body(file, [file.to_mesh().convex_hull]), file.key, free=False)
    body.quat = [np.cos(0.2), 0, 0, np.sin(0.2)]
    finger = spec.worldbody.add_body(name="finger", pos=[-0.1, 0, 0])
    finger.add_joint(name="slide", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[1, 0, 0], damping=[20, 0, 0])
    finger.add_geom(size=[0.005, 0, 0], mass=0.05)
    finger.add_site(name="pad", pos=[0.006, 0, 0])
    spec.add_actuator(name="slide", target="slide", trntype=mujoco.mjtTrn.mjTRN_JOINT)
    return spec.compile()


def felt_on_brick(brick, at, axes, body_at, body_axes):
    """Forces of pads at sites, (B,): depth 0, as the apex is where the site is."""
    pose = relative_poses(*map(torch.as_tensor, (at, axes, body_at, body_axes)))
    return BatchedTouch(brick, "digit").press(0, pose, depth=0.0, fitted=False).wrench


def test_sites_of_a_simulation_press_where_they_are(brick):
    """From gap to contact as the finger moves: the deeper, the more, and nothing before."""
    model = pressing(brick)
    data, depths = mujoco.MjData(model), np.array([-0.01, 0.0005, 0.001])
    found = []
    mujoco.mj_forward(model, data)
    turn = data.body(brick.key).xmat.reshape(3, 3)
    start, forward = data.site("pad").xpos @ turn, np.array([1.0, 0.0, 0.0]) @ turn
    met, _ = brick.surface.caster.first_hit(start[None] / brick.scale, forward[None])
    reach = met[0] * brick.scale
    for depth in depths:
        data.qpos[0] = reach + depth
        mujoco.mj_kinematics(model, data)
        of = data.site("pad"), data.body(brick.key)
        found.append([*(v.copy() for one in of for v in (one.xpos, one.xmat.reshape(3, 3)))])
    wrench = felt_on_brick(brick, *(np.stack(v) for v in zip(*found)))
    assert wrench[0].abs().max() == 0
    assert 0 < wrench[1, 0] < wrench[2, 0]


def test_worlds_of_mujoco_warp_press_an_object(brick):
    """The last steps of 16 worlds in which motors of other strengths press the finger."""
    warp_worlds = pytest.importorskip("mujoco_warp")
    import warp

    model, count = pressing(brick), 16
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    worlds, states = warp_worlds.put_model(model), warp_worlds.put_data(model, data, nworld=count)
    strengths = np.linspace(1.0, 3.0, count, dtype=np.float32)
    states.ctrl.assign(strengths[:, None])
    for _ in range(500):
        warp_worlds.step(worlds, states)
    site, body = model.site("pad").id, model.body(brick.key).id
    of = (states.site_xpos, site), (states.site_xmat, site), (states.xpos, body), (states.xmat, body)
    wrench = felt_on_brick(brick, *(warp.to_torch(array)[:, number] for array, number in of))
    assert (wrench[:, 0] > 0).all()
    assert wrench[-1, 0] > wrench[0, 0]


def test_arguments_of_other_shapes_are_refused(touch, contacts):
    with pytest.raises(ObjectFolderError, match="either pose=, or points= and normals="):
        touch.press(0)
    with pytest.raises(ObjectFolderError, match="depth cannot be read as numbers of shape"):
        touch.press(**contacts | {"depth": contacts["depth"][:3]})
    with pytest.raises(ObjectFolderError, match="object_index has 3 numbers for 8 contacts"):
        touch.press(**contacts | {"object_index": contacts["object_index"][:3]})
    with pytest.raises(ObjectFolderError, match="expected whole numbers"):
        touch.press(**contacts | {"object_index": 0.5})


def test_an_unusable_device_is_refused(files):
    with pytest.raises(ObjectFolderError, match="which torch cannot use here"):
        BatchedTouch(files, device="no such device")


def test_large_calls_of_a_file_are_answered_on_a_gpu(brick, brick_path, monkeypatch):
    """Here by the same code on a CPU, whose rays are Embree's."""
    points, file = brick.sample_surface(70), ObjectFile.load(brick_path)
    expected = brick.press(points, 0.0012, 0.4)
    monkeypatch.setattr(senses, "has_fast_rays", lambda device: True)
    found = file.press(points, 0.0012, 0.4)
    for name in ("images", "height", "displacement", "pressure", "force", "obstructed"):
        one, other = getattr(found, name), getattr(expected, name)
        assert (one.dtype, one.shape) == (other.dtype, other.shape)
    assert any(
        (getattr(found, name) != getattr(expected, name)).any() for name in ("pressure", "displacement")
    )
    np.testing.assert_allclose(found.force, expected.force, rtol=1e-4, atol=1e-6)
    assert psnr(np.mean((found.images / 255 - expected.images / 255) ** 2)) > 70
    few = file.press(points[:3], 0.0012, 0.4)
    assert (few.images == brick.press(points[:3], 0.0012, 0.4).images).all()
