"""Many episodes of ``ObjectFolder/Explore-v0`` together, which feel in batches."""

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np

from objectfolder.base.checks import whole_number
from objectfolder.base.errors import ObjectFolderError, quoted
from objectfolder.objectfile.file import ObjectFile
from objectfolder.sim import calls
from objectfolder.sim.batched_touch import BatchedTouch
from objectfolder.sim.explore import COST, DEPTH, ExploreEnv, Probe, upright_angles
from objectfolder.touch.profiles import SensorProfile


class ExploreVectorEnv(gymnasium.vector.VectorEnv[Any, np.ndarray, np.ndarray]):
    """Many episodes of `ExploreEnv`, whose touches are one batch on a device.

    Environment k with the seed s + k does what `ExploreEnv` does with that seed, but for the rounding of
    images. An episode that ends is followed by the first observation of the next one in the same step
    (autoreset mode SAME_STEP), with ``final_obs`` and ``final_info`` in ``info``.

    Parameters
    ----------
    num_envs : int
    objects, noise, limit, sensor, reduction : as `ExploreEnv`
    device : str
        On which touches are computed; see `BatchedTouch`.

    Raises
    ------
    ObjectFolderError
        As `ExploreEnv` and `BatchedTouch`, or if a reset has another number of seeds.
    """

    metadata = {  # noqa: RUF012
        "autoreset_mode": gymnasium.vector.AutoresetMode.SAME_STEP,
        "render_modes": [],
    }

    def __init__(
        self, num_envs: int = 1,
        objects: "str | ObjectFile | Sequence[str | ObjectFile]" = ("mug", "die", "bell"),
        noise: float = 0.001, limit: int = 30, sensor: "str | SensorProfile" = "digit", reduction: int = 4,
        device: str = "cpu",
    ):  # fmt: skip
        self.num_envs = whole_number("num_envs", num_envs, 1)
        self._one = ExploreEnv(objects, noise, limit, sensor, reduction)
        self._touch = BatchedTouch(self._one.files, self._one.profile, device)
        self.single_observation_space = self._one.observation_space
        self.single_action_space = self._one.action_space
        self.observation_space = gymnasium.vector.utils.batch_space(self.single_observation_space, num_envs)
        self.action_space = gymnasium.vector.utils.batch_space(self.single_action_space, num_envs)
        self._background = self._touch.background.cpu().numpy()
        self._generators: list[np.random.Generator] = []
        self._episodes: dict[str, np.ndarray] = {}
        self._touches = np.zeros(num_envs, int)

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Draw all episodes, with the seeds s, s + 1, ..., or with one of a list for each."""
        calls.refuse_options(options)
        count = self.num_envs
        seeds = [*seed] if isinstance(seed, list | tuple | np.ndarray) else [seed] * count
        if len(seeds) != count:
            raise ObjectFolderError(
                f"seed is {quoted(seed)}, expected one, or one for each of {count} environments"
            )
        step = 0 if isinstance(seed, list | tuple | np.ndarray) else 1
        numbers = [None if s is None else whole_number("seed", s) + step * k for k, s in enumerate(seeds)]
        new = [gymnasium.utils.seeding.np_random(number)[0] for number in numbers]
        kept = self._generators or new
        self._generators = [new[k] if numbers[k] is not None else kept[k] for k in range(count)]
        self._episodes = {"object": np.zeros(count, int), "scale": np.zeros(count), "yaw": np.zeros(count)}
        self._begin(np.arange(count))
        return self._untouched(), self._info()

    def step(
        self, actions: np.ndarray
    ) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Touch or name each object; episodes that end are followed by new ones."""
        calls.require_reset(bool(self._episodes))
        chosen, right = self._checked(actions), self._episodes["object"]
        named = chosen >= self._one.places
        rewards = np.where(named, chosen - self._one.places == right, -COST).astype(np.float64)
        rows = np.flatnonzero(~named)
        observed = self._untouched()
        if len(rows):
            felt = self.feel(rows, chosen[rows])
            errors = np.stack([self._generators[k].normal(size=3) for k in rows]) * self._one.noise
            places = self._one.felt_places(chosen[rows], felt.radius, errors)
            hit = rows[felt.touched]
            observed["touch"][hit], observed["touched"][hit] = felt.images[felt.touched], 1
            observed["contact"][hit] = places[felt.touched]
        self._touches[rows] += 1
        cut = ~named & (self._touches >= self._one.limit)
        ended = named | cut
        if not ended.any():
            return observed, rewards, named, cut, self._info()
        last = np.full(self.num_envs, None, object)
        every = [*gymnasium.vector.utils.iterate(self.observation_space, observed)]
        for k in np.flatnonzero(ended):
            last[k] = {name: np.array(of) for name, of in every[k].items()}
        final = {name: of for name, of in self._info().items() if not name.startswith("_")}
        final |= {f"_{name}": ended for name in final}
        self._begin(np.flatnonzero(ended))
        for name, of in self._untouched().items():
            observed[name][ended] = of[ended]
        info = {"final_obs": last, "_final_obs": ended, "final_info": final, "_final_info": ended}
        return observed, rewards, named, cut, self._info() | info

    def feel(self, rows: np.ndarray, places: np.ndarray) -> Probe:
        """Touch the objects of some environments (N,) at places (N,), the numbers of actions."""
        kinds, scales, yaws = (self._episodes[name][rows] for name in ("object", "scale", "yaw"))
        points, outward = np.zeros((2, len(rows), 3))
        radius, touched = np.zeros(len(rows)), np.zeros(len(rows), bool)
        for kind in np.unique(kinds):
            of = np.flatnonzero(kinds == kind)
            met = self._one.approach(int(kind), scales[of], yaws[of], places[of])
            points[of], outward[of], radius[of], touched[of] = met
        images = np.broadcast_to(self._background, (len(rows), *self._background.shape)).copy()
        if touched.any():
            pressed = self._touch.press(
                kinds[touched], points=points[touched], normals=outward[touched],
                angle=upright_angles(outward[touched]), depth=DEPTH, scale=scales[touched], fitted=False,
            )  # fmt: skip
            images[touched] = pressed.images.cpu().numpy()
        return Probe(images, radius, touched)

    def _begin(self, rows: np.ndarray) -> None:
        for row in rows:
            for name, value in self._one.draw_episode(self._generators[row]).items():
                self._episodes[name][row] = value
        self._touches[rows] = 0

    def _checked(self, actions: np.ndarray) -> np.ndarray:
        values, most = np.asarray(actions), int(self.single_action_space.n) - 1  # type: ignore[attr-defined]
        whole = values.dtype.kind in "iu" and values.shape == (self.num_envs,)
        if not whole or not ((values >= 0) & (values <= most)).all():
            raise ObjectFolderError(
                f"action is {quoted(actions)}, expected {self.num_envs} whole numbers from 0 to {most}"
            )
        return values.astype(int)

    def _untouched(self) -> dict[str, np.ndarray]:
        return {
            "touch": np.tile(self._background, (self.num_envs, 1, 1, 1)),
            "contact": np.zeros((self.num_envs, 3), np.float32),
            "touched": np.zeros(self.num_envs, np.int64),
        }

    def _info(self) -> dict[str, Any]:
        every = np.ones(self.num_envs, bool)
        return {name: of.copy() for name, of in self._episodes.items()} | {
            f"_{n}": every for n in self._episodes
        }
