"""Impacts that are heard, compared with what the simulation applies."""

import copy
import pickle

import mujoco
import numpy as np
import pytest

from objectfolder.objectfile.file import ObjectFile
from objectfolder.sim.body import add_body, rigid_body, rotation
from objectfolder.sim.hearing import Hearing

HEIGHT = 0.2


@pytest.fixture(scope="module")
def samples():
    files = {name: ObjectFile.sample(name) for name in ("die", "mug", "bell")}
    return {name: (file, rigid_body(file, [file.to_mesh().convex_hull])) for name, file in files.items()}


class Heard:
    """A simulation with one object, the first body, and the sums of what was heard and applied."""

    def __init__(self, spec, file, body):
        self.model, self.body = spec.compile(), body
        self.data = mujoco.MjData(self.model)
        self.hearing = Hearing(self.model, {"object": file}, [0.5, 0, 0.3])
        self.heard, self.lost, self.borne, self.strikes = np.zeros(3), 0.0, 0.0, []

    def step(self):
        data = self.data
        mujoco.mj_step(self.model, data)
        self.hearing.hear(data)
        for strike in self.hearing.strikes:
            self.heard += data.xmat[1].reshape(3, 3) @ strike.impulse
            self.lost += strike.lost
            self.strikes.append((data.time, strike))
        if (data.contact.efc_address >= 0).any():  # the share of the weight
            self.borne += self.body.mass * -self.model.opt.gravity[2] * self.model.opt.timestep

    @property
    def momentum(self):
        turn = rotation(self.data.qpos[3:7])
        velocity, spin = self.data.qvel[:3], turn @ self.data.qvel[3:6]
        return self.body.mass * (velocity + np.cross(spin, turn @ self.body.centre))


def above_a_floor(sample, step, quat=(1, 0, 0, 0)):
    file, body = sample
    spec = mujoco.MjSpec()
    spec.option.timestep = step
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[5, 5, 0.1])
    fallen = add_body(spec, body, "object")
    fallen.quat = np.array(quat, float) / np.linalg.norm(quat)
    fallen.pos = [0, 0, HEIGHT - (body.points @ rotation(fallen.quat).T)[:, 2].min()]
    return Heard(spec, file, body)


def struck(sample, kind, z, mu, step=0.002):
    """Without weight, a hammer flies against the object: free, with a joint, or moved from outside."""
    file, body = sample
    spec = mujoco.MjSpec()
    spec.option.gravity, spec.option.timestep = [0, 0, 0], step
    hit = add_body(spec, body, "object")
    hammer = spec.worldbody.add_body(name="hammer", pos=[-0.15, 0, z], mocap=kind == "mocap")
    if kind == "slide":
        hammer.add_joint(type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[1, 0, 0])
    elif kind == "hinge":
        hammer.add_joint(type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, -1, 0], pos=[0, 0, 0.3])
    hammer.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.01, 0, 0], mass=0.1)
    for geom in (*hit.geoms, *hammer.geoms):
        geom.friction = [mu, 0.005, 0.0001]
    scene = Heard(spec, file, body)
    if kind != "mocap":
        scene.data.qvel[6] = 0.5 if kind == "slide" else 0.5 / 0.3
    return scene


@pytest.mark.parametrize("step", [0.002, 0.001, 0.0005])
@pytest.mark.parametrize("quat", [(1, 0, 0, 0), (1, 0.3, 0.5, 0.1)])
@pytest.mark.parametrize("name", ["die", "mug", "bell"])
def test_one_landing_is_heard_once_whatever_the_time_step(samples, name, quat, step):
    """On a face or on a corner; MuJoCo's points of contact jump from vertex to vertex meanwhile."""
    scene = above_a_floor(samples[name], step, quat)
    before = scene.momentum[2]
    while scene.data.time < 0.26:
        scene.step()
    weight = scene.body.mass * 9.81 * scene.data.time
    applied = scene.momentum[2] - before + weight - scene.borne
    assert scene.heard[2] == pytest.approx(applied, rel=0.15)
    assert 0 < len(scene.strikes) <= 5
    assert scene.lost <= scene.body.mass * 9.81 * HEIGHT


@pytest.mark.parametrize("mu", [1e-5, 1.0])
@pytest.mark.parametrize(("name", "z"), [("bell", 0), ("bell", -0.02), ("mug", 0.03), ("die", 0.075)])
@pytest.mark.parametrize("kind", ["slide", "hinge"])
def test_a_hammer_with_a_joint_gives_the_impulse_that_the_simulation_applies(samples, kind, name, z, mu):
    """The joint makes the hammer slide where it hits, and friction acts on the impulse along the normal."""
    scene = struck(samples[name], kind, z, mu)
    while scene.data.time < 0.4 and not (scene.strikes and not scene.data.ncon):
        scene.step()
    assert np.linalg.norm(scene.heard - scene.momentum) < 0.15 * np.linalg.norm(scene.momentum)


@pytest.mark.parametrize("name", ["mug", "die"])
def test_a_blow_by_a_mocap_body_is_heard(samples, name):
    """As of a body of any mass: the object ends with its speed. A teleport onto the object is no blow."""
    scene, step = struck(samples[name], "mocap", 0.0, 1e-5), 0.002
    for k in range(300):
        scene.data.mocap_pos[0, 0] = -0.15 + 0.5 * k * step
        scene.step()
        if scene.strikes and scene.data.time > scene.strikes[0][0] + 0.2:
            break
    assert len(scene.strikes) == 1
    assert scene.heard == pytest.approx(scene.momentum, abs=0.15 * np.linalg.norm(scene.momentum))
    assert scene.strikes[0][1].speed == pytest.approx(0.5, rel=0.05)
    put = struck(samples[name], "mocap", 0.0, 1e-5)
    for place in (-0.15, scene.data.xpos[2, 0] - scene.data.xpos[1, 0]):
        put.data.mocap_pos[0, 0] = place
        put.step()
    assert put.data.ncon > 0
    assert not put.strikes


def test_a_mocap_body_that_turns_strikes_with_the_speed_of_its_end(samples):
    file, body = samples["die"]
    spec = mujoco.MjSpec()
    spec.option.gravity = [0, 0, 0]
    add_body(spec, body, "object")
    arm = spec.worldbody.add_body(name="arm", pos=[-0.12, 0, 0.3], mocap=True)
    arm.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.01, 0, 0], pos=[0, 0, -0.3])
    scene = Heard(spec, file, body)
    for k in range(400):
        angle = 0.5 - 2.0 * k * 0.002  # about y
        scene.data.mocap_quat[0] = [np.cos(angle / 2), 0, np.sin(angle / 2), 0]
        scene.step()
        if scene.strikes:
            break
    assert scene.strikes[0][1].speed == pytest.approx(2.0 * 0.3, rel=0.1)
    assert scene.heard[0] > 0


def test_a_bounce_and_a_second_edge_are_heard_by_themselves(samples):
    """A springy floor throws the bell back; a mug that lands on an edge hits with the other one, too."""
    file, body = samples["bell"]
    spec = mujoco.MjSpec()
    floor = {"type": mujoco.mjtGeom.mjGEOM_PLANE, "size": [5, 5, 0.1]}
    spec.worldbody.add_geom(solref=[0.02, 0.1], priority=1, **floor)
    add_body(spec, body, "object").pos = [0, 0, HEIGHT - body.points[:, 2].min()]
    scene, touched = Heard(spec, file, body), []
    while scene.data.time < 0.8:
        count = len(scene.strikes)
        scene.step()
        touched += [scene.data.time] if len(scene.strikes) > count else []
    assert sum(np.diff(touched) > 0.05) >= 1  # apart from the first landing
    lean = above_a_floor(samples["mug"], 0.002, (1, 0.05, 0, 0))
    while lean.data.time < 0.6:
        lean.step()
    points = np.array([strike.point for _, strike in lean.strikes])
    assert np.ptp(points[:, 1]) > 0.03  # both edges
    assert lean.lost <= lean.body.mass * 9.81 * HEIGHT


def test_a_copy_and_a_reset_amid_an_impact(samples):
    """What is pending goes along with a copy, and is forgotten by a reset."""
    scene = above_a_floor(samples["die"], 0.002)
    while not scene.strikes:
        scene.step()
    scene.step()
    state, hearing = scene.data, scene.hearing
    copies = [(copy.deepcopy(state), copy.deepcopy(hearing)), pickle.loads(pickle.dumps((state, hearing)))]
    expected = hearing.simulate(state, 40).tobytes()
    assert [other.simulate(data, 40).tobytes() for data, other in copies] == [expected] * 2
    sounds = []
    for _ in range(2):
        mujoco.mj_resetData(scene.model, state)
        hearing.reset(state)
        sounds.append(hearing.simulate(state, 105).tobytes())  # ends amid the impact
    assert sounds[0] == sounds[1]
