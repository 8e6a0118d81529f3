"""Whatever hearing and feeling read of a simulation is checked: a test for each field."""

import ast
import copy
import inspect
import re
from contextlib import nullcontext
from itertools import product

import gymnasium
import mujoco
import numpy as np
import pytest
from refusals import refused

from objectfolder.base.errors import ObjectFolderError
from objectfolder.sim import feeling, hearing, impacts, sounding, state
from objectfolder.sim.body import add_body
from objectfolder.sim.feeling import Feeling
from objectfolder.sim.hearing import Hearing
from objectfolder.sim.senses import Senses

SENSES = ["Hearing", "Feeling"]
#: What MuJoCo's functions read of the data that they are given.
CALLED = {"mj_step": (), "mj_jac": ("cdof", "subtree_com"), "mj_solveM": ("qLD", "qLDiagInv"),
          "mj_contactForce": ("efc_force",)}  # fmt: skip
#: Sizes and names of a model, and functions of its arrays, which MuJoCo keeps from being changed.
SIZES = {"nbody", "nsite", "nv", "nmocap", "opt", "body", "geom", "pair", "site"}


def scene(body):
    """A brick on a table that a mocap striker with a pad presses on; a mocap ear; and an arm with a motor."""
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(name="table", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1, 1, 0.1])
    spec.worldbody.add_body(name="head", mocap=True, pos=[0.3, 0, 0.3]).add_site(name="ear")
    striker = spec.worldbody.add_body(name="striker", mocap=True, pos=[0, 0, 0.0495])
    striker.quat = [0.5**0.5, 0, 0.5**0.5, 0]  # +x looks down
    striker.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.02, 0.02, 0.02], condim=4)
    striker.add_site(name="pad", pos=[0.02, 0, 0])
    add_body(spec, body, "brick").pos = [0, 0, 0.016]
    arm = spec.worldbody.add_body(name="arm", pos=[0.5, 0, 0.3])
    arm.add_joint(name="arm", axis=[0, 1, 0])
    arm.add_geom(name="fist", size=[0.02, 0, 0], pos=[0.1, 0, 0])
    spec.add_pair(name="apart", geomname1="table", geomname2="fist")
    motor = spec.add_actuator(name="arm", target="arm", trntype=mujoco.mjtTrn.mjTRN_JOINT)
    motor.dyntype, motor.dynprm[0] = mujoco.mjtDyn.mjDYN_FILTER, 0.1
    return spec.compile()


@pytest.fixture
def stepped(body, brick, tmp_path, monkeypatch):
    """Return a function that makes a model, its data after some steps, and the sense that is to read them."""
    monkeypatch.chdir(tmp_path)  # MuJoCo writes a log

    def made(kind):
        model = scene(body)
        data = mujoco.MjData(model)
        sense = Hearing(model, [brick], "ear") if kind == "Hearing" else Feeling(model, "pad", [brick])
        for _ in range(30):
            mujoco.mj_step(model, data)
            if kind == "Hearing":
                sense.hear(data)
        mujoco.mj_step(model, data)
        return model, data, sense, sense.hear if kind == "Hearing" else sense.feel

    return made


def test_all_that_is_read_is_in_the_lists():
    read, of_model = set(), set()
    for module in (hearing, impacts, feeling, sounding):
        for node in ast.walk(ast.parse(inspect.getsource(module))):
            if isinstance(node, ast.Attribute):
                if ast.unparse(node.value) in ("data", "contact"):
                    read.add(node.attr)
                elif ast.unparse(node.value) in ("model", "self._model"):
                    of_model.add(node.attr)
                elif ast.unparse(node.value) in ("model.opt", "self._model.opt"):
                    of_model.add(f"opt.{node.attr}")
            if isinstance(node, ast.Call) and "data" in map(ast.unparse, node.args):
                name = ast.unparse(node.func)
                read |= {*CALLED[name[7:]]} if name.startswith("mujoco.mj_") else set()
    assert {"xmat", "mocap_quat", "efc_vel", "solref"} <= read
    assert read - {"time", "contact", "ncon"} <= {*state.DATA, *state.CONTACT, *state.CONTACT_PLACES}
    listed = {*state.STRUCTURE, *state.SHAPES, *state.DYNAMICS, "opt.timestep", "opt.cone"}
    assert {"body_mass", "geom_bodyid", "opt.gravity"} <= of_model
    assert of_model - SIZES <= listed


@pytest.mark.parametrize("kind", SENSES)
def test_a_number_that_is_not_finite_is_refused_wherever_it_is(stepped, kind):
    """Nothing is heard or forgotten meanwhile: afterwards, the sense goes on as if it had not been asked."""
    _, data, sense, ask = stepped(kind)
    expected = copy.deepcopy(sense), copy.deepcopy(data)
    for name in state.DATA:
        values = getattr(data, name)
        assert values.size, name
        for row, wrong in product((0, values.size - 1), (np.nan, np.inf, -np.inf, 1e16)):
            before, values.flat[row] = values.flat[row], wrong
            refused(rf"{name}\[\d+\] is .*{re.escape(format(wrong, 'g'))}", ask, data)
            values.flat[row] = before
    assert data.ncon > 1
    for name, row in product((*state.CONTACT, *state.CONTACT_PLACES), (0, data.ncon - 1)):
        one = data.contact[row]
        for wrong in (999,) if name in state.CONTACT_PLACES else (np.nan, np.inf):
            before = np.array(getattr(one, name))
            setattr(one, name, np.full_like(before, wrong) if before.ndim else wrong)
            refused(rf"contact \d .*{name}.*{wrong:g}.* at 0\.062 s", ask, data)
            setattr(one, name, before if before.ndim else before.item())
    before, data.time = data.time, np.nan
    refused("time is nan s", ask, data)
    data.time = before
    same, untouched = expected
    if kind == "Hearing":
        heard = [np.r_[a.hear(b), a.simulate(b, 20)] for a, b in ((sense, data), (same, untouched))]
        assert heard[0].tobytes() == heard[1].tobytes()
        assert heard[0].any()
    else:
        assert ask(data).images.tobytes() == same.feel(untouched).images.tobytes()


@pytest.mark.parametrize("kind", SENSES)
@pytest.mark.parametrize("field", ["mocap_pos", "mocap_quat"])
@pytest.mark.parametrize("owner", ["striker", "head"])
def test_a_mocap_body_that_is_nowhere_is_named(stepped, kind, field, owner):
    """Or MuJoCo has noticed it in a contact, and has set the simulation back."""
    model, data, _, ask = stepped(kind)
    ask(data)
    getattr(data, field)[model.body(owner).mocapid[0]] = np.nan
    mujoco.mj_step(model, data)
    refused(rf"body '{owner}': {field}\[\d\] is \[nan, .*set such mocap poses|simulation diverged", ask, data)


@pytest.mark.parametrize("kind", SENSES)
def test_a_model_that_became_another_one_is_refused(stepped, kind):
    """Each field that says what bodies are; and data of a model that differs in it."""
    model, data, _, ask = stepped(kind)
    fixed = {*state.STRUCTURE, "opt.cone"} | ({"opt.timestep"} if kind == "Hearing" else set())
    for name in (*fixed, *state.SHAPES, *(state.DYNAMICS if kind == "Hearing" else ())):
        for place in (model, copy.deepcopy(model)):
            owner, short = (place.opt, name[4:]) if "." in name else (place, name)
            before = copy.copy(getattr(owner, short))
            changed = before + 1 if name in fixed or before.dtype.kind != "f" else 3 * before + 1
            wrong = f"{name}.* of the model .*changed since {kind} was made"
            if place is not model:
                wrong = rf"another model than {kind}: .*{name}\[\d\] is .*, expected"
            elif name not in fixed:  # it may change, but not to this
                if before.dtype.kind != "f":
                    continue
                changed, wrong = np.full_like(before, np.nan), rf"{name}\[\d\] of the model is .*nan"
            setattr(owner, short, changed)
            asked = data if place is model else mujoco.MjData(place)
            refused(wrong, ask, asked)
            setattr(owner, short, before)
    ask(data)


@pytest.mark.parametrize(
    ("field", "factor", "message"),
    [
        ("body_mass", 2, r"body_mass of the model changed since Hearing was made: body 'brick' weighs"),
        ("body_inertia", 2, r"body_inertia .*: body 'brick' has 2 to 2 times the moments of inertia"),
        ("mesh_vert", 2, r"mesh_vert .*: the geoms of body 'brick' reach from"),
        ("geom_solref", 0.1, r"geom_solref .*time constant of 0\.002 s, expected at least two time steps"),
        ("body_mass", -1, r"body_mass\[\d\] of the model is -.*, expected finite numbers of at least 0"),
        ("body_mass", 1.05, None),
        ("geom_friction", 2, None),
    ],
)
def test_what_may_change_is_checked_as_at_first(stepped, field, factor, message):
    model, data, _, ask = stepped("Hearing")
    values = getattr(model, field)
    values *= factor
    for _ in range(2):
        with nullcontext() if message is None else pytest.raises(ObjectFolderError, match=message):
            ask(data)
            mujoco.mj_step(model, data)


def test_gravity_may_change(stepped):
    model, data, sense, ask = stepped("Hearing")
    before = sense._reader.min_speed
    model.opt.gravity *= 2
    ask(data)
    assert sense._reader.min_speed == pytest.approx(2 * before)


@pytest.mark.parametrize(
    ("kind", "field"),
    [("Hearing", field) for field in ("body_mass", "body_inertia", "geom_solref", "mesh_vert", "opt.gravity")]
    + [("Feeling", "mesh_vert")],
)
def test_a_model_that_is_not_finite_is_refused_at_once(body, brick, kind, field):
    model = scene(body)
    (model.opt.gravity if "." in field else getattr(model, field))[-1] = np.nan
    with pytest.raises(ObjectFolderError, match=rf"{field}\[\d+\] of the model is .*nan"):
        Hearing(model, [brick], "ear") if kind == "Hearing" else Feeling(model, "pad", [brick])


NO_DATA = [None, 3, "data", [None], np.zeros(3), mujoco.MjSpec()]


@pytest.mark.parametrize("given", NO_DATA, ids=lambda given: type(given).__name__)
def test_what_is_no_data_is_named(stepped, given):
    _, data, hearing, hear = stepped("Hearing")
    _, felt, _, feel = stepped("Feeling")
    for ask in (hear, hearing.reset, lambda given: hearing.simulate(given, 1), feel):
        if ask == hearing.reset and given is None:
            continue  # at 0
        refused(r"data(\[0\])? is .*, expected the mujoco\.MjData of", ask, given)
    refused(r"data\[1\] is None, expected the mujoco\.MjData", feel, [felt, None])
    hear(data)


def test_a_mocap_quaternion_may_have_any_length(stepped):
    """MuJoCo normalizes what it reads; so does the striker's speed of turning."""
    heard = []
    for length in (1, 10):
        model, data, _, ask = stepped("Hearing")
        data.mocap_quat[:] *= length
        sounds = [ask(data)]
        for k in range(40):
            half = 0.1 * np.sin(0.2 * k)
            mujoco.mju_mulQuat(data.mocap_quat[1], np.array([np.cos(half), np.sin(half), 0, 0]),
                               length * model.body("striker").quat)  # fmt: skip
            mujoco.mj_step(model, data)
            sounds.append(ask(data))
        heard.append(np.concatenate(sounds))
    assert abs(heard[0]).max() > 1e-3
    np.testing.assert_allclose(heard[1], heard[0], atol=1e-3 * abs(heard[0]).max())


class Pressed(gymnasium.Env):
    """Presses on the brick."""

    observation_space = gymnasium.spaces.Box(-1, 1, (1,), np.float32)
    action_space = gymnasium.spaces.Discrete(1)
    mj_step = staticmethod(mujoco.mj_step)

    def __init__(self, body):
        self.body, self.model = body, scene(body)
        self.data = mujoco.MjData(self.model)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return np.zeros(1, np.float32), {}

    def step(self, action):
        self.mj_step(self.model, self.data, nstep=3)
        return np.zeros(1, np.float32), 0.0, False, False, {}


def test_environments_are_checked_as_well(body, brick, tmp_path, monkeypatch):
    """One of two goes wrong; and one gets another model, other data, or none."""
    monkeypatch.chdir(tmp_path)

    def made():
        return Senses(Pressed(body), [brick], "ear", ["pad"], seconds=0.01)

    many = gymnasium.vector.SyncVectorEnv([made, made])
    many.reset(seed=0)
    many.step([0, 0])
    many.envs[1].unwrapped.data.mocap_pos[0] = np.nan
    refused(r"body 'head': mocap_pos\[0\] is \[nan", many.step, [0, 0])
    env = made()
    env.reset(seed=0)
    inner = env.unwrapped
    inner.model = copy.deepcopy(inner.model)
    inner.model.body_mass *= 2
    inner.data = mujoco.MjData(inner.model)
    refused(r"another model than Hearing: body 'striker': body_mass", env.reset, seed=0)
    inner.data = None
    refused("data of Pressed is None, expected", env.reset, seed=0)
