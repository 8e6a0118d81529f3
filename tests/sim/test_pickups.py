"""Contact microphones on objects and on the pads of a gripper, and how a grip damps."""

import mujoco
import numpy as np
import pytest
import scipy.linalg
from refusals import refused

from objectfolder.sim import hearing
from objectfolder.sim.body import add_body, rigid_body
from objectfolder.sim.hearing import Hearing
from objectfolder.sim.pickups import SHEAR, Pad

RATE = 48000
BOX = mujoco.mjtGeom.mjGEOM_BOX
STIFF = Pad(2e6, 0, 0.3)


@pytest.fixture
def smooth(monkeypatch):
    """Surfaces without roughness, whose contacts make no noise."""
    monkeypatch.setattr(hearing, "scrape_force", lambda load, *_: (0 * load, load))


def falling(file, *spots):
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(name="table", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[2, 2, 0.1])
    body = add_body(spec, rigid_body(file, [file.to_mesh().convex_hull]), file.key)
    body.pos, body.quat = [0, 0, 0.1], [0.95, 0.25, 0.18, 0]
    for k, spot in enumerate(spots):
        body.add_site(name=f"spot{k}", pos=spot)
    return spec.compile()


def held(file, force=5.0, hammer=True):
    """The file between two pads on sliders, without weight, and a hammer above it on a slider."""
    spec = mujoco.MjSpec()
    spec.option.timestep, spec.option.gravity = 0.001, [0, 0, 0]
    add_body(spec, rigid_body(file, [file.to_mesh().convex_hull]), file.key)
    reach = file.bounds[1, 0]
    for name, sign in (("left", -1), ("right", 1)):
        pad = spec.worldbody.add_body(name=name, pos=[sign * (reach + 0.0105), 0, 0])
        pad.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[-sign, 0, 0], damping=20)
        pad.add_geom(type=BOX, size=[0.01, 0.01, 0.01], mass=0.1, friction=[1, 0.005, 0.0001])
        pad.add_site(
            name=f"{name}_pad", pos=[-sign * 0.01, 0, 0], quat=[1, 0, 0, 0] if sign < 0 else [0, 0, 0, 1]
        )
        motor = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.gainprm[0] = force
    ball = spec.worldbody.add_body(name="hammer", pos=[0.02, 0.01, file.bounds[1, 2] + 0.03])
    ball.add_joint(type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0, 0, -1])
    ball.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.01, 0, 0], mass=0.01)
    return spec.compile()


def struck(model, file, grip=1.0, **options):
    """Let the hammer go after 150 of 300 steps; return sound, its strikes, energies of modes, the hearing."""
    data, one = mujoco.MjData(model), Hearing(model, [file], surroundings="steel", **options)
    data.ctrl[:] = grip
    sounds, strikes, energies = [], [], []
    for k in range(300):
        if k == 150:
            data.qvel[-1] = 1.0
        sounds.append(one.simulate(data))
        strikes += one.strikes if k > 150 else ()
        energies.append(one._stream.energy[0, :-3])
    return np.concatenate(sounds, -1), strikes, np.array(energies), one


def test_a_glued_microphone_hears_the_strikes_asked_of_the_file(brick, smooth):
    spots = brick.sample_surface(2, seed=3)
    model = falling(brick, *spots)
    data, both = mujoco.MjData(model), Hearing(model, [brick], pickup=["spot1", "spot0"])
    parts, strikes = [], []
    for _ in range(250):
        parts.append(both.simulate(data))
        strikes += both.strikes
    heard, expected = np.concatenate(parts, 1), np.zeros((2, RATE // 2))
    assert len(strikes) > 3
    for strike in strikes:
        left = heard.shape[1] - strike.start
        expected[:, strike.start :] += brick.impact(
            np.tile(strike.point, (2, 1)), strike.impulse[None], RATE, left / RATE, "acceleration",
            tolerance=0.3, contact_time=strike.contact_time, pickup=spots[::-1],
        )  # fmt: skip
    assert heard.shape == (2, RATE // 2)
    assert abs(heard - expected).max() < 1e-4 * abs(expected).max()
    alone = Hearing(model, [brick], pickup="spot0").simulate(mujoco.MjData(model), 250)
    np.testing.assert_allclose(alone, heard[1], atol=1e-5 * abs(expected).max())


def test_a_pad_hears_the_surface_that_it_touches(brick, smooth):
    """One that is too soft to damp hears what a microphone glued to the touched point does."""
    model = held(brick)
    soft = {"left_pad": Pad(0, 0, 0), "right_pad": Pad(0, 0, 0)}
    heard, strikes, _, _ = struck(model, brick, pickup=["right_pad", "left_pad"], pads=soft)
    (strike,) = strikes
    count = heard.shape[1] - strike.start
    expected = brick.impact(
        strike.point[None], strike.impulse[None], RATE, count / RATE, "acceleration", tolerance=0.3,
        contact_time=strike.contact_time, pickup=brick.bounds[::-1] * [[1, 0, 0]],
        axis=[[-1, 0, 0], [1, 0, 0]],
    )  # fmt: skip
    np.testing.assert_allclose(heard[:, strike.start :], expected, atol=0.02 * abs(expected).max())
    away, _, energies, _ = struck(model, brick, 0.0, pickup="left_pad", pads=soft)
    soon = slice(strike.start + 480)  # later, the brick meets the pad
    assert energies[180].any()
    assert not away[soon].any()


@pytest.mark.parametrize("listening", [{"pickup": "left_pad"}, {"listener": [0, 0, 0.3]}])
def test_a_grip_damps_by_the_formula(brick, smooth, listening):
    """Modes decay at their own rate and that of both pads, until they are let go."""
    model = held(brick)
    pads = {"left_pad": STIFF, "right_pad": STIFF}
    _, (strike,), energies, _ = struck(model, brick, pads=pads, **listening)
    step = strike.start * 1000 // RATE + 2
    found = np.log(energies[step] / energies[step + 2]) / (2 * 0.002)
    own = brick.tuning()
    angular, ends = own.damped_frequency.numpy(), brick.mode_shapes(brick.bounds * [[1, 0, 0]])
    across = np.sqrt(np.square(ends[:, 1:]).sum(1))
    added = [STIFF.damping(angular, x, yz) for x, yz in zip(ends[:, 0], across)]
    expected = own.damping.numpy() + sum(added)
    rings = energies[step + 2] > 1e-6 * energies[step].max()
    assert rings.sum() > 3
    assert (sum(added) / own.damping.numpy())[rings].max() > 0.5
    np.testing.assert_allclose(found[rings], expected[rings], rtol=0.03)
    _, _, energies, _ = struck(model, brick, 0.0, pads=pads, **listening)
    found = np.log(energies[step] / energies[step + 2]) / (2 * 0.002)
    np.testing.assert_allclose(found[rings], own.damping.numpy()[rings], rtol=1e-3)


def test_damping_is_the_first_order_of_the_coupled_problem(brick):
    """Half the stiffness, a quarter of the error, against complex modes of object and springs."""
    own, (shape,) = brick.tuning(), brick.mode_shapes(brick.bounds[1:] * [[1, 0, 0]])
    angular, errors = own.damped_frequency.numpy(), []
    for stiffness in (1e5, 5e4):
        pad = Pad(stiffness, 0, 0.2)
        springs = pad.stiffness * (1 + 0.2j) * np.diag([1, SHEAR, SHEAR])
        squares = np.sort(scipy.linalg.eigvals(np.diag(angular**2) + shape.T @ springs @ shape))
        added = pad.damping(angular, shape[0], np.sqrt(np.square(shape[1:]).sum(0)))
        errors.append(abs(np.sqrt(squares).imag - added).max())
        assert errors[-1] < 0.02 * added.max()
    assert errors[1] < 0.3 * errors[0]


def test_the_stiffness_is_that_of_a_block_of_masses_and_springs():
    pad, count = Pad(3e4, 5e-4, 0.3), 2000
    spring, mass = pad.stiffness * (1 + 0.3j) * count, pad.mass / count
    for hertz in (50, 900, 4000, 15000):
        angular = 2 * np.pi * hertz
        force, moved = spring, 1.0  # of the first spring from the back, whose mass moves by one
        for _ in range(count - 1):
            force = force - angular**2 * mass * moved  # borne by the next spring
            moved = moved + force / spring
        assert pad.dynamic_stiffness(np.array([angular])) == pytest.approx(force / moved, rel=5e-3)
    assert Pad(3e4, 0, 0.3).dynamic_stiffness(np.array([1e3, 1e5])) == pytest.approx(3e4 * (1 + 0.3j))


def test_what_makes_no_sense_is_refused(brick):
    model = held(brick)
    refused("give either listener or pickup", Hearing, model, [brick])
    refused("give either listener or pickup", Hearing, model, [brick], [0, 0, 1], pickup="left_pad")
    refused("pickup: the scene has no site 'ear'", Hearing, model, [brick], pickup="ear")
    refused(r"pickup is \[\], expected the name of a site", Hearing, model, [brick], pickup=[])
    refused("expected a Pad", Hearing, model, [brick], [0, 0, 1], pads={"left_pad": 3})
    refused("pads: the scene has no site", Hearing, model, [brick], [0, 0, 1], pads={"x": Pad()})
    refused("loss of a pad is -1", Pad, loss=-1)
    off = falling(brick, [0, 0, 0.03])
    refused("site 'spot0' is 0.015 m off the surface of brick", Hearing, off, [brick], pickup="spot0")
    refused("'spot0' is on the object 'brick'", Hearing, off, [brick], [0, 0, 1], pads={"spot0": Pad()})
