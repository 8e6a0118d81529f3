import copy

import mujoco
import numpy as np
import pytest
from refusals import refused

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.materials import friction_of
from objectfolder.sim.body import add_body, rigid_body
from objectfolder.sim.feeling import Feeling
from objectfolder.sim.sounding import Sounding

PADS = ["left_pad", "right_pad"]
FORCE = 2.0  #: N of each finger


def fingers(file, yaw=0.0, on_cart=False):
    """Two fingers that slide onto an object without weight, all turned about the vertical.

    The object moves freely, or is fixed to a cart that does.
    """
    spec = mujoco.MjSpec()
    spec.option.gravity = [0, 0, 0]
    cos, sin = np.cos(yaw), np.sin(yaw)
    turn, cart = [np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)], None
    if on_cart:
        cart = spec.worldbody.add_body(name="cart", quat=turn)
        cart.add_freejoint()
        cart.add_geom(size=[0.01, 0, 0], contype=0, conaffinity=0)
    body = add_body(spec, rigid_body(file, [file.to_mesh().convex_hull]), file.key, cart)
    body.quat = [1, 0, 0, 0] if on_cart else turn
    for name, side in (("left", 1), ("right", -1)):
        towards = yaw - side * np.pi / 2
        finger = spec.worldbody.add_body(name=name, pos=[-sin * side * 0.06, cos * side * 0.06, 0])
        finger.quat = [np.cos(towards / 2), 0, 0, np.sin(towards / 2)]
        finger.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[1, 0, 0], damping=[20, 0, 0])
        finger.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.002, 0.01, 0.01], pos=[-0.002, 0, 0], mass=0.05,
            condim=4, friction=[0.8, 0.01, 0.001],
        )  # fmt: skip
        finger.add_site(name=f"{name}_pad")
        spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    return spec.compile()


def squeezed(model, pull=0.0, steps=300):
    data = mujoco.MjData(model)
    data.ctrl[:] = FORCE
    mujoco.mj_step(model, data, steps)
    data.xfrc_applied[1, 2] = -pull
    mujoco.mj_step(model, data, 100)
    return data


@pytest.fixture(scope="module")
def model(brick):
    return fingers(brick)


@pytest.fixture(scope="module")
def feeling(model, brick):
    return Feeling(model, PADS, [brick])


def test_the_gel_bears_the_force_of_the_fingers(model, feeling):
    felt = feeling.feel(squeezed(model))
    assert felt.images.shape == (2, 160, 120, 3)
    assert (felt.touched == 1).all()
    assert felt.force[:, 0] == pytest.approx([FORCE, FORCE], rel=0.02)
    assert felt.borne[:, 0] == pytest.approx(felt.force[:, 0], rel=0.1)
    assert abs(felt.force[:, 1:]).max() < 0.05 * FORCE
    assert (felt.depth > 1e-4).all()
    assert (felt.area > 1e-5).all()


def test_the_gel_slides_on_what_the_body_is_made_of(model, brick):
    wooden = Feeling(model, PADS, {brick.key: Sounding(brick, "wood")})
    assert set(wooden._friction.values()) == {friction_of("wood")}
    assert friction_of(brick.material) != friction_of("wood")


def test_what_pulls_at_the_object_shears_the_gel(model, feeling):
    """Half of the pull at each finger, downwards in the image; markers move to larger rows."""
    felt = feeling.feel(squeezed(model, pull=0.8))
    assert felt.force[:, 2] == pytest.approx([-0.4, -0.4], rel=0.05)
    assert felt.borne[:, 2] == pytest.approx(felt.force[:, 2], rel=0.1)
    assert (felt.shear[:, 1] < -1e-5).all()
    still = feeling.feel(squeezed(model)).marker_flow
    assert ((felt.marker_flow - still)[..., 1].max(1) > 0.2).all()


def test_many_environments_feel_what_each_does_alone(model, feeling):
    data = [squeezed(model), squeezed(model, pull=0.5), mujoco.MjData(model)]
    together = feeling.feel(data)
    assert together.images.shape == (3, 2, 160, 120, 3)
    for k, one in enumerate(data):
        alone = feeling.feel(one)
        for name, value in vars(alone).items():
            assert getattr(together, name)[k].tobytes() == value.tobytes(), name
    assert (together.touched[2] == 0).all()
    assert together.images[2, 0].tobytes() == together.images[2, 1].tobytes()  # the untouched gel's


def test_the_frame_of_the_world_does_not_matter(brick, model, feeling):
    turned = fingers(brick, yaw=1.1)
    here = feeling.feel(squeezed(model, 0.5))
    there = Feeling(turned, PADS, [brick]).feel(squeezed(turned, 0.5))
    assert there.force == pytest.approx(here.force, abs=2e-3)
    assert there.depth == pytest.approx(here.depth, abs=5e-6)
    assert abs(there.images.astype(int) - here.images).mean() < 0.5


def test_an_object_that_is_fixed_to_a_cart_feels_as_a_free_one(brick, model, feeling):
    carted = fingers(brick, yaw=0.7, on_cart=True)
    free, fixed = feeling.feel(squeezed(model)), Feeling(carted, PADS, [brick]).feel(squeezed(carted))
    assert (fixed.touched == carted.body("brick").id).all()
    assert carted.body("brick").jntnum[0] == 0
    assert fixed.force == pytest.approx(free.force, abs=0.02)
    assert fixed.depth == pytest.approx(free.depth, rel=0.05)


def test_wrong_arguments_are_refused(model, brick, feeling):
    for pads, message in (
        (["thumb"], r"no site 'thumb', but \['left_pad', 'right_pad'\]"),
        ([], "pads is empty"),
        (3, "pads is 3, expected the names of sites on fingers"),
        (None, "pads is None, expected the names"),
        (["left_pad", 3], r"pads is \['left_pad', 3\], expected the names"),
    ):
        refused(message, Feeling, model, pads, [brick])
    refused("gel of sensor 'tacto_digit' is rigid", Feeling, model, PADS, [brick], sensor="tacto_digit")
    with pytest.raises(
        ObjectFolderError, match=r"touch needs the object's own size, 0.1 m, but it has 0.2 m"
    ):
        Feeling(model, PADS, {"brick": Sounding(brick, scale=0.2)})
    refused("no body 'cup'", Feeling, model, PADS, {"cup": brick})
    larger = copy.deepcopy(model)
    larger.mesh_vert[:] *= 2
    refused(r"geoms of body 'brick' reach from .* touch needs the object's", Feeling, larger, PADS, [brick])
