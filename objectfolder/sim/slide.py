"""Slide: a tactile sensor slides over an object until it feels, or sees, what it did at a goal."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import spaces

from objectfolder.base.checks import one_of, whole_number
from objectfolder.base.errors import ObjectFolderError
from objectfolder.objectfile.file import ObjectFile
from objectfolder.sim import calls
from objectfolder.sim.game import Game
from objectfolder.sim.sliding import (
    SENSES,
    SLIDES,
    STEPS,
    Poses,
    errors,
    is_reached,
    moved,
    observe,
    random_poses,
    require_sliding,
    strayed,
)


class SlideEnv(Game):
    """Slide a sensor to a contact that is known by its reading, registered as ``ObjectFolder/Slide-v0``.

    **Observation**, a dict: for each of the senses, ``touch`` and ``vision``, what it tells at the sensor,
    and with ``goal_`` before its name, at the goal; (80, 60, 3) uint8. Vision is the close view of the spot
    that the gel covers. **Action**: in [-1, 1], the motion right and up in the view from outside and the
    turn, as shares of the greatest in a step. **Reward**: by how many steps the sensor comes nearer, and 1 at
    the goal, which ends the episode; ``limit`` steps truncate it. ``info`` holds ``distance`` (m) and
    ``angle`` (radians) from the goal.

    Each episode draws a contact, uniform by area, and a start from which the surface leads to it.

    Parameters
    ----------
    file : str, Path or ObjectFile
        Name of a sample of the package, or an Object File.
    task : {"refine", "traverse"}
        ``refine``: up to 3 mm and 15 degrees away; the goal is within 0.5 mm and 1 degree, steps are 1 mm and
        5 degrees. ``traverse``: 5 to 15 mm along the surface, within 1 mm, steps of 2 mm.
    senses : sequence of {"touch", "vision"}
    limit : int
        Greatest number of steps.
    size : (int, int)
        Height and width of the images.
    """

    _changing = ("_episode", "_steps", "_poses", "_goals", "_shown")

    def __init__(
        self, file: "str | ObjectFile" = "mug", task: str = "refine", senses: Sequence[str] = ("touch",),
        limit: int = STEPS, size: tuple[int, int] = (80, 60),
    ):  # fmt: skip
        self.file, self.limit = calls.object_file(file), whole_number("limit", limit, 1)
        self.slide = SLIDES[one_of("task", task, tuple(SLIDES))]
        given = [senses] if isinstance(senses, str) else senses
        named = [one_of("senses", one, SENSES) for one in given]
        if not named:
            raise ObjectFolderError(f"senses is empty, expected {', '.join(SENSES)} or both")
        self.senses = [name for name in SENSES if name in named]
        require_sliding(self.file, self.senses)
        self._size, self._episode, self._steps = calls.check_resolution(size), {}, 0
        self._poses = self._goals = Poses(*np.zeros((3, 1, 3)))
        self._shown: dict[str, np.ndarray] = {}
        self._arguments = (self.file, task, tuple(self.senses), limit, self._size)
        image = spaces.Box(0, 255, (*self._size, 3), np.uint8)
        names = [goal + name for name in self.senses for goal in ("", "goal_")]
        self.observation_space = spaces.Dict(dict.fromkeys(names, image))
        self.action_space = spaces.Box(-1, 1, (3,), np.float32)

    def _begin(self, rng: np.random.Generator) -> tuple[Any, dict[str, Any]]:
        self._goals = random_poses(self.file, 1, rng)
        self._poses = strayed(self.file, self.slide, self._goals, rng)
        self._shown = self._read("goal_", self._goals)
        self._steps, self._episode = 0, self._info()
        return self._observation(), dict(self._episode)

    def step(self, action: np.ndarray) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Slide, and feel and look there."""
        calls.require_reset(bool(self._episode))
        shares = calls.check_actions(action, (3,)).clip(-1, 1)
        before, slide = self._away(), self.slide
        self._poses = moved(self.file, self._poses, shares[None] * slide.steps)
        self._steps += 1
        reached = bool(is_reached(slide, self._poses, self._goals)[0])
        cut, info = not reached and self._steps >= self.limit, self._info()
        self._episode = {} if reached or cut else info
        reward = before - self._away() + reached
        return self._observation(), reward, reached, cut, dict(info)

    def _observation(self) -> dict[str, np.ndarray]:
        return self._read("", self._poses) | {name: shown.copy() for name, shown in self._shown.items()}

    def _read(self, prefix: str, poses: Poses) -> dict[str, np.ndarray]:
        pictures = observe(self.file, poses, self.senses, self._size)[0]
        return {prefix + name: pictures[..., 3 * k : 3 * k + 3] for k, name in enumerate(self.senses)}

    def _info(self) -> dict[str, float]:
        distance, angle = errors(self._poses, self._goals)[0]
        return {"distance": float(distance), "angle": float(angle)}

    def _away(self) -> float:
        """Return how many steps the goal is away; turns count where they matter."""
        distance, angle = errors(self._poses, self._goals)[0]
        turns = angle / self.slide.step_turn if np.isfinite(self.slide.turned) else 0.0
        return float(max(distance / self.slide.step, turns))
