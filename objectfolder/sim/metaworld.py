"""Meta-World's reach-v3 with its Sawyer arm, and an Object File in place of its cylinder.

Needs ``metaworld`` 3.1.1 in a separate Python environment, since it pins another MuJoCo (docs/benchmarks.md).
"""

from pathlib import Path
from typing import Any

import gymnasium
import mujoco
import numpy as np
from gymnasium.spaces import Box

from objectfolder.base.checks import whole_number
from objectfolder.base.errors import ObjectFolderError
from objectfolder.objectfile.file import ObjectFile
from objectfolder.sim.body import Hulls, RigidBody, add_body, as_rigid_body
from objectfolder.sim.reach import GOAL_HIGH, GOAL_LOW, OBJECT_HIGH, OBJECT_LOW, check_size, lowest_point

try:
    from metaworld.envs.sawyer_reach_v3 import SawyerReachEnvV3
except ModuleNotFoundError as error:
    raise ObjectFolderError(
        f"{error.name} is not installed; this needs metaworld 3.1.1 in a separate Python environment, since "
        "it pins another MuJoCo: see docs/benchmarks.md, Reach with Meta-World's arm"
    ) from error

#: Parameters that Meta-World writes into a weld; newer versions of MuJoCo have more.
WELD = [0.0] * 6 + [-1.0] + [0.0] * 3 + [5.0]


class SawyerReachObject(SawyerReachEnvV3):
    """``SawyerReachEnvV3`` with another object; goals are observed, and drawn from the seeded generator."""

    def __init__(self, body: RigidBody):
        self._body = body  # the base class builds the simulation in its __init__
        super().__init__()
        self._freeze_rand_vec, self.seeded_rand_vec = False, True
        self._set_task_called = True
        self._partially_observable = False
        self.__dict__.pop("sawyer_observation_space", None)  # cached for hidden goals
        height = -lowest_point(body)
        self.init_config["obj_init_pos"][2] = height
        low, high = (*OBJECT_LOW, height, *GOAL_LOW), (*OBJECT_HIGH, height, *GOAL_HIGH)
        self._random_reset_space = Box(np.array(low), np.array(high), dtype=np.float64)

    def _initialize_simulation(self) -> tuple[mujoco.MjModel, mujoco.MjData]:
        spec = mujoco.MjSpec.from_file(self.fullpath)
        old = spec.body("obj")
        spec.delete(old) if hasattr(spec, "delete") else spec.detach_body(old)  # MuJoCo 4, and 3.3
        add_body(spec, self._body, "obj")
        model = spec.compile()
        model.vis.global_.offwidth, model.vis.global_.offheight = self.width, self.height
        return model, mujoco.MjData(model)

    def reset_mocap_welds(self) -> None:
        """Let the hand follow its target as in Meta-World, with MuJoCo 4 as well."""
        welds = self.model.eq_type == mujoco.mjtEq.mjEQ_WELD
        self.model.eq_data[welds, : len(WELD)] = WELD

    def _get_pos_objects(self) -> np.ndarray:
        return self.data.body("obj").xpos.copy()

    def _get_quat_objects(self) -> np.ndarray:
        return np.roll(self.data.body("obj").xquat, -1)  # x, y, z, w, Meta-World's order


class MetaWorldReach(gymnasium.Env[np.ndarray, np.ndarray]):
    """Meta-World's reach-v3 with any object, as a plain Gymnasium environment.

    Like `objectfolder.sim.reach.ReachEnv`, but with the Sawyer arm. ``reset`` honours its seed, which
    Meta-World ignores, and goals are part of the observation, as in MT1.

    Arguments are as there, but ``horizon`` is at most 500 control steps (12.5 ms).
    """

    metadata = {"render_modes": []}  # noqa: RUF012 - as the base class has it

    def __init__(self, file: "ObjectFile | RigidBody | str | Path", hulls: Hulls = None, horizon: int = 500):
        if whole_number("horizon", horizon, 1) > SawyerReachEnvV3.max_path_length:
            raise ObjectFolderError(f"horizon is {horizon}, expected 1 to {SawyerReachEnvV3.max_path_length}")
        body = as_rigid_body(file, hulls)
        check_size(body)
        self.env = SawyerReachObject(body)
        self.horizon = horizon
        self.observation_space = self.env.sawyer_observation_space
        self.action_space = self.env.action_space

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Reset the hand, and draw new places of the object and the goal."""
        super().reset(seed=seed)
        self.env.seed(int(self.np_random.integers(2**31)))
        observation, _ = self.env.reset()
        space: Box = self.observation_space  # type: ignore[assignment]
        return np.clip(observation, space.low, space.high), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Simulate one control step, 12.5 ms."""
        observation, reward, _, _, info = self.env.step(action)
        kept = {"success": float(info["success"]), "distance": float(info["obj_to_target"])}
        return observation, float(reward), False, self.env.curr_path_length >= self.horizon, kept

    def close(self) -> None:
        """Release Meta-World's resources."""
        self.env.close()
