import gymnasium
import mujoco
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from refusals import refused
from test_feeling import fingers

from objectfolder.base.errors import ObjectFolderError
from objectfolder.sim.hearing import Hearing
from objectfolder.sim.reach import SUBSTEPS, ReachEnv
from objectfolder.sim.senses import Senses

EAR = [0.0, 0.4, 0.4]


def lifted(env):
    """Let the object of a reach environment fall from 10 cm."""
    inner = env.unwrapped
    inner.data.qpos[inner._object + 2] += 0.1
    mujoco.mj_forward(inner.model, inner.data)


@pytest.mark.parametrize("by_name", [False, True])
def test_the_checker_passes(body, brick, by_name):
    name = "objectfolder.sim:ObjectFolder/Reach-v0"
    made = gymnasium.make(name, file=body, horizon=5) if by_name else ReachEnv(body, horizon=5)
    env = Senses(made, {"object": brick}, EAR, seconds=0.05)
    with pytest.warns(UserWarning, match="different from the unwrapped version"):  # it is a wrapper
        check_env(env, skip_render_check=True)
    observation, _ = env.reset(seed=0)
    assert env.observation_space.contains(observation)
    assert env.observation_space.contains(env.step(env.action_space.sample())[0])
    assert observation["audio"].shape == (2400,)


def test_a_wrapped_environment_is_made_again_from_its_spec(body, brick):
    made = gymnasium.make("objectfolder.sim:ObjectFolder/Reach-v0", file=body, horizon=5)
    env = Senses(made, {"object": brick}, EAR, seconds=0.05)
    again = gymnasium.make(env.spec)
    assert again.reset(seed=3)[0]["observation"].tobytes() == env.reset(seed=3)[0]["observation"].tobytes()


def test_two_ears_have_two_names(body, brick):
    objects, right = {"object": brick}, [0.3, 0.5, 0.2]
    env = Senses(ReachEnv(body), objects, EAR, seconds=0.5)
    refused("an entry 'audio' already; give another name by audio=", Senses, env, objects, right)
    refused("an entry 'x' already", Senses, Still(brick), [brick], EAR, audio="x", intercept=True)
    with pytest.raises(ObjectFolderError, match="an entry 'both' already"):
        Senses(Still(brick), [brick], EAR, ["left_pad"], audio="both", touch="both", intercept=True)
    env = Senses(env, objects, right, seconds=0.5, audio="right")
    assert {*env.reset(seed=1)[0]} == {*env.observation_space.spaces} == {"observation", "audio", "right"}
    lifted(env)
    for _ in range(40):
        observation, *_ = env.step(np.zeros(4, np.float32))
    assert observation["audio"].any()
    assert observation["right"].any()
    assert observation["audio"].tobytes() != observation["right"].tobytes()


def test_every_step_of_the_simulation_is_heard(body, brick):
    env = Senses(ReachEnv(body), {"object": brick}, EAR, seconds=0.5)
    env.reset(seed=1)
    lifted(env)
    inner = env.unwrapped
    other, hearing = mujoco.MjData(inner.model), Hearing(inner.model, {"object": brick}, EAR)
    kind = mujoco.mjtState.mjSTATE_INTEGRATION
    state = np.empty(mujoco.mj_stateSize(inner.model, kind))
    mujoco.mj_getState(inner.model, inner.data, state, kind)
    mujoco.mj_setState(inner.model, other, state, kind)
    hearing.reset(other)
    for _ in range(40):
        observation, *_ = env.step(np.zeros(4, np.float32))
    other.ctrl[:] = inner.data.ctrl
    heard = hearing.simulate(other, 40 * SUBSTEPS)
    assert "mj_step" not in vars(inner)
    assert np.abs(heard).max() > 1e-3
    assert observation["audio"].tobytes() == heard[-24000:].tobytes()
    assert not env.reset(seed=1)[0]["audio"].any()


def test_environments_side_by_side_hear_what_each_does_alone(body, brick):
    def made():
        return Senses(ReachEnv(body, horizon=20), {"object": brick}, EAR)

    many = gymnasium.vector.SyncVectorEnv([made, made])
    together, _ = many.reset(seed=[3, 4])
    for env in many.envs:
        lifted(env)
    for _ in range(12):
        together, *_ = many.step(np.zeros((2, 4), np.float32))
    alone = made()
    alone.reset(seed=4)
    lifted(alone)
    for _ in range(12):
        observation, *_ = alone.step(np.zeros(4, np.float32))
    assert together["audio"][1].any()
    assert together["audio"][1].tobytes() == observation["audio"].tobytes()


class Still(gymnasium.Env):
    """Fingers that squeeze an object, without a step of its own."""

    observation_space = gymnasium.spaces.Dict({"x": gymnasium.spaces.Box(-1, 1, (1,), np.float32)})
    action_space = gymnasium.spaces.Discrete(1)

    def __init__(self, brick):
        self.model = fingers(brick)
        self.data = mujoco.MjData(self.model)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        mujoco.mj_resetData(self.model, self.data)
        self.data.ctrl[:] = 2
        return {"x": np.zeros(1, np.float32)}, {}

    def step(self, action):
        mujoco.mj_step(self.model, self.data, nstep=200)
        return {"x": np.zeros(1, np.float32)}, 0.0, False, False, {}


def test_pads_add_touch(brick):
    env = Senses(Still(brick), [brick], pads=["left_pad", "right_pad"])
    first, _ = env.reset(seed=0)
    after, *_ = env.step(0)
    assert {*after} == {"x", "touch"}
    assert env.observation_space.contains(after)
    assert first["touch"][0].tobytes() == first["touch"][1].tobytes()
    assert (abs(after["touch"].astype(int) - first["touch"]).max((1, 2, 3)) > 5).all()


def test_mujoco_is_as_before_unless_an_environment_without_a_step_of_its_own_steps(body, brick):
    made, seen = mujoco.mj_step, []

    def watched(env):
        env.step = lambda action, step=env.step: (seen.append(mujoco.mj_step), step(action))[1]
        return env

    refused("Still has no mj_step by which it could be heard", Senses, Still(brick), [brick], EAR)
    own = Senses(watched(ReachEnv(body)), {"object": brick}, EAR)
    own.reset(seed=0)
    own.step(np.zeros(4, np.float32))
    assert seen.pop() is made
    other = Senses(watched(Still(brick)), [brick], EAR, intercept=True)
    other.reset(seed=0)
    assert mujoco.mj_step is made
    heard = other.step(0)[0]["audio"]
    assert seen.pop() is not made
    assert mujoco.mj_step is made
    assert heard.any()
    other.env.step = lambda action: 1 / 0
    with pytest.raises(ZeroDivisionError):
        other.step(0)
    assert mujoco.mj_step is made


def test_what_has_no_senses_is_refused(body, brick):
    for env, name in ((gymnasium.make("CartPole-v1"), "CartPoleEnv"), (None, "NoneType")):
        refused(f"{name} has no model and data of MuJoCo", Senses, env, [brick], EAR)
    for change, message in (
        ({"listener": None}, "neither a listener nor a pad"),
        ({"pads": 3}, "pads is 3, expected the names of sites"),
        ({"seconds": 0}, "seconds is 0"),
        ({"seconds": 1e12}, r"seconds is 1e\+12: needs [\d,]+ bytes.*ask for fewer"),
        ({"sample_rate": 1e12}, r"Hearing: needs [\d,]+ bytes.*lower the sample rate, 1e\+12 Hz"),
        ({"sample_rate": None}, "sample_rate is None, expected a finite number"),
        ({"audio": None}, "None is not the name of an entry, expected a text"),
    ):
        refused(message, Senses, ReachEnv(body), {"object": brick}, **{"listener": EAR} | change)


def test_one_pad_has_one_picture(brick):
    env = Senses(Still(brick), (one for one in [brick]), EAR, pads="left_pad", seconds=0.01, intercept=True)
    observation, _ = env.reset(seed=0)
    assert env.observation_space.contains(observation)
    assert observation["touch"].shape[0] == 1


def test_steps_that_are_not_heard_are_refused(body, brick):
    class Deaf(ReachEnv):
        def step(self, action):
            for _ in range(3):
                mujoco.mj_step1(self.model, self.data)
                mujoco.mj_step2(self.model, self.data)
            return np.zeros(39, np.float32), 0.0, False, False, {}

    env = Senses(Deaf(body), {"object": brick}, EAR)
    env.reset(seed=0)
    refused(r"Deaf simulated 0\.\d+ s that were not heard: step by its", env.step, np.zeros(4, np.float32))
