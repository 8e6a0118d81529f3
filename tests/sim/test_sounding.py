"""Objects of a scene: which bodies they are, and whether those are as their files say."""

import mujoco
import numpy as np
import pytest
from refusals import refused

from objectfolder.base.errors import ObjectFolderError
from objectfolder.objectfile.file import ObjectFile
from objectfolder.sim.body import add_body, rigid_body, scaled_body
from objectfolder.sim.feeling import Feeling
from objectfolder.sim.hearing import Hearing
from objectfolder.sim.sounding import Sounding, name_objects

EAR = [0.5, 0, 0.3]


def scene(body, *names):
    spec = mujoco.MjSpec()
    spec.option.gravity = [0, 0, 0]
    for k, name in enumerate(names):
        add_body(spec, body, name).pos = [k, 0, 0]
    spec.worldbody.add_site(name="pad")
    return spec


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (None, "objects is None, expected Object Files"),
        ("brick", "objects is 'brick', expected Object Files"),
        (3, "objects is 3, expected Object Files"),
        ([], "objects is empty"),
        (["brick"], "'brick' is of type str, expected an ObjectFile"),
        ({"cup": None}, "'cup' is of type NoneType"),
        ({1: None}, "objects: 1 is not the name of a body"),
    ],
)
def test_what_is_no_object_is_named(given, message):
    refused(message, name_objects, given)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"file": None}, "file of a Sounding is of type NoneType, expected an ObjectFile"),
        ({"material": "cheese"}, "unknown material 'cheese'"),
        ({"material": 3}, "unknown material 3"),
        ({"scale": "large"}, "scale is 'large', expected a finite number"),
        ({"scale": np.nan}, "scale is nan, expected a finite number"),
        ({"scale": -0.1}, r"scale is -0\.1 m, expected the longest side, above 0"),
    ],
)
def test_what_is_no_sounding_is_named(brick, change, message):
    refused(message, Sounding, **{"file": brick} | change)


def test_simple_geoms_have_the_sizes_that_they_have_now(brick):
    """Their boxes stay as they were compiled."""
    spec = mujoco.MjSpec()
    made = spec.worldbody.add_body(name="brick")
    made.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.05, 0.03, 0.015], mass=0.2)
    made.add_site(name="pad")
    model = spec.compile()
    data, feeling = mujoco.MjData(model), Feeling(model, "pad", [brick])
    feeling.feel(data)
    model.geom_size *= 1.5
    refused(r"geom_size of the model changed .*: the geoms of body 'bric", feeling.feel, data)


def test_a_model_has_to_be_compiled(body, brick):
    for sense in (lambda spec: Hearing(spec, [brick], EAR), lambda spec: Feeling(spec, "pad", [brick])):
        refused(r"model is of type MjSpec, .* what spec\.compile\(\) ret", sense, scene(body, "brick"))


def test_a_body_is_one_object(body, brick):
    model = scene(body, "left/brick").compile()
    twice = {"brick": brick, "left/brick": brick}
    for sense in (lambda: Hearing(model, twice, EAR), lambda: Feeling(model, "pad", twice)):
        refused("'brick' and 'left/brick' are both body 'left/brick'", sense)


def test_data_of_another_model_are_refused(body, brick):
    model, other = scene(body, "brick").compile(), scene(body, "brick", "more").compile()
    data = mujoco.MjData(other)
    mujoco.mj_step(other, data)
    for sense in (Hearing(model, [brick], EAR).hear, Feeling(model, "pad", [brick]).feel):
        refused(r"of another model than .* nbody = 3, expected 2", sense, data)


@pytest.mark.parametrize("setting", ["boundinertia", "align"])
def test_a_body_whose_inertia_was_changed_is_refused(body, brick, setting):
    """By settings that are made after it was added; the second one turns the body's frame."""
    spec = scene(body, "brick")
    if setting == "align":
        spec.joint("brick").align = mujoco.mjtAlignFree.mjALIGNFREE_TRUE
    else:
        spec.compiler.boundinertia = 1.5 * body.principal()[0][0]
    with pytest.raises(ObjectFolderError, match=r"body 'brick' has .* times the moments of inertia of brick"):
        Hearing(spec.compile(), [brick], EAR)


def test_an_object_of_another_size_and_material_has_the_inertia_of_both(body, brick):
    model = scene(scaled_body(body, 1.5, 7850 / 1070), "brick").compile()
    Hearing(model, {"brick": Sounding(brick, "steel", 1.5 * brick.scale)}, EAR)
    model.body_inertia *= 1.35
    with pytest.raises(
        ObjectFolderError, match=r"has 1\.35 to 1\.35 times the moments .* of steel and 0\.15 m"
    ):
        Hearing(model, {"brick": Sounding(brick, "steel", 1.5 * brick.scale)}, EAR)


def test_an_object_that_is_fixed_to_a_cart_is_heard_in_its_frame(body, brick):
    """The cart, turned by a right angle, runs along +x into a ball at rest."""
    spec = mujoco.MjSpec()
    spec.option.gravity = [0, 0, 0]
    cart = spec.worldbody.add_body(name="cart", quat=[np.sqrt(0.5), 0, 0, np.sqrt(0.5)])
    cart.add_freejoint()
    cart.add_geom(size=[0.02, 0, 0], mass=5, contype=0, conaffinity=0)
    add_body(spec, body, "brick", cart)
    ball = spec.worldbody.add_body(name="ball", pos=[0.06, 0, 0])
    ball.add_freejoint()
    ball.add_geom(size=[0.01, 0, 0], mass=0.1)
    model = spec.compile()
    data, hearing = mujoco.MjData(model), Hearing(model, [brick], EAR)
    data.qvel[0] = 0.5
    strikes, loudest = [], 0.0
    for _ in range(100):
        loudest = max(loudest, abs(hearing.simulate(data)).max())
        strikes += hearing.strikes
    got = 0.1 * data.qvel[6:9]  # momentum of the ball
    assert got[0] > 0.03
    assert {strike.body for strike in strikes} == {"brick"}
    np.testing.assert_allclose(sum(strike.impulse for strike in strikes), [0, got[0], 0], atol=0.15 * got[0])
    assert strikes[0].point[1] == pytest.approx(body.bounds[0, 1], abs=1e-3)
    assert loudest > 1e-3


def test_a_real_object_is_as_full_of_another_material_and_size_as_of_its_own(body, brick):
    real = ObjectFile(brick.header | {"mass": 0.25 * body.mass}, brick.tensors)
    weighed = rigid_body(real, body.hulls)
    Hearing(scene(weighed, "brick").compile(), [real], EAR)
    refused("weighs 0.1926 kg in the scene, but brick of plastic and 0.1 m weighs 0.04815 kg", Hearing,
            scene(body, "brick").compile(), [real], EAR)  # fmt: skip
    model = scene(scaled_body(weighed, 1.5, 7850 / 1070), "brick").compile()
    assert model.body("brick").mass[0] == pytest.approx(0.25 * 7850 * 0.1 * 0.06 * 0.03 * 1.5**3)
    Hearing(model, {"brick": Sounding(real, "steel", 1.5 * brick.scale)}, EAR)
