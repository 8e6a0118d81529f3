"""Explore: an object of unknown size and direction stands on a table unseen; name it by a few touches.

`Explorer` does so from a belief: the trained baseline of ``ObjectFolder/Explore-v0``.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from gymnasium import spaces

from objectfolder.base.checks import finite_number, whole_number
from objectfolder.base.errors import ObjectFolderError
from objectfolder.objectfile.file import ObjectFile
from objectfolder.sim import calls
from objectfolder.sim.drop import SIZES
from objectfolder.sim.fingers import sensor_angles
from objectfolder.sim.game import Game
from objectfolder.touch.optics import Optics
from objectfolder.touch.profiles import SensorProfile, load_profile
from objectfolder.touch.simulate import press

AZIMUTHS, HEIGHTS = 12, 6  #: directions and heights from which the gel comes
DEPTH = 0.001  #: of a press, m
COST = 0.05  #: of a touch
SHAPES = 48  #: sizes and yaws of each object in the table
COMPONENTS = 6  #: of tactile images
BLOCK = 5  #: pixels of an image that are averaged, each way
MISMATCH = 0.02  #: probability that a touch meets the object where the table says it does not, or the reverse
WIDTHS = (0.001, 0.002, 0.004), (0.15, 0.3, 0.6, 1.2)  #: of likelihoods that are tried: radius, m; components
SAMPLES = 40  #: answers that an expected gain is a mean of
HYPOTHESES = 1000  #: drawn from the belief, that it takes into account
_LOG_SIZES = math.log(SIZES[0]), math.log(SIZES[1])


@dataclass(frozen=True)
class Probe:
    """What touches of one object give, before the noise of the hand."""

    images: np.ndarray  #: (N, H, W, 3) uint8; untouched ones where the gel meets nothing
    radius: np.ndarray  #: (N,) m, of the contact from the vertical axis; 0 where there is none
    touched: np.ndarray  #: (N,) bool


class ExploreEnv(Game):
    """Name an object by touch, registered as ``ObjectFolder/Explore-v0``.

    **Observation**, a dict: ``touch``, the tactile image, (40, 30, 3) uint8 of a DIGIT; ``contact``, its
    place, (3,) float32, world frame, m; ``touched``, 1 if the gel met the object, else 0, and the place is 0.
    **Action**: k below 72 touches: from azimuth 30 (k mod 12) degrees, at height (k div 12 + 0.5) / 6 of the
    tallest object. 72 + i names object i, which ends the episode. **Reward**: 1 for the right name, 0 for
    another, -0.05 for a touch. The touch number ``limit`` truncates the episode. ``info`` holds ``object``,
    the right number, ``scale`` (m) and ``yaw`` (radians).

    Each episode draws an object, its size (0.8 to 1.25 times its own) and its yaw. Its frame's origin is
    above the origin of the world, and it stands on z = 0. The gel comes along a horizontal ray to the
    vertical axis, with world z up in the image, and is pressed 1 mm past the first point of the surface on
    the ray. The place is known with an error that is normal with the standard deviation ``noise``.

    Parameters
    ----------
    objects : sequence of str or ObjectFile
        Names of samples of the package, or Object Files; of different keys. One may stand for itself.
    noise : float
        Of the hand's position along each axis, m.
    limit : int
        Greatest number of touches.
    sensor : str, Path or SensorProfile
    reduction : int
        Of the sensor's resolution, each way. With 3, images of a DIGIT have 53 x 40 pixels, enough for the
        CNN of stable-baselines3, which takes 36 x 36 or more.
    """

    _changing = ("_episode", "_touches")

    def __init__(
        self, objects: "str | ObjectFile | Sequence[str | ObjectFile]" = ("mug", "die", "bell"),
        noise: float = 0.001, limit: int = 30, sensor: "str | SensorProfile" = "digit", reduction: int = 4,
    ):  # fmt: skip
        self.files = calls.open_files(objects)
        self.noise, self.limit = finite_number("noise", noise), whole_number("limit", limit, 1)
        if self.noise < 0:
            raise ObjectFolderError(f"noise is {noise!r} m, expected a number of at least 0")
        self._arguments = (self.files, noise, limit, sensor, reduction)
        full, divisor = load_profile(sensor), whole_number("reduction", reduction, 1)
        height, width = full.height // divisor, full.width // divisor
        if not (height and width):
            raise ObjectFolderError(
                f"reduction is {reduction!r}, expected {min(full.height, full.width)} at most for {full.name}"
            )
        self.profile = replace(full, height=height, width=width)
        self._optics = Optics(self.profile)
        bounds = np.stack([file.bounds for file in self.files])
        self._tallest = float((bounds[:, 1, 2] - bounds[:, 0, 2]).max())
        self._reach = 1.1 * SIZES[1] * float(np.hypot(*abs(bounds).max(1)[:, :2].T).max())
        self.places = AZIMUTHS * HEIGHTS
        high = np.array([self._reach, self._reach, self._tallest]) + 10 * self.noise
        self.observation_space = spaces.Dict(
            {
                "touch": spaces.Box(0, 255, (height, width, 3), np.uint8),
                "contact": spaces.Box(-high.astype(np.float32), high.astype(np.float32), dtype=np.float32),
                "touched": spaces.Discrete(2),
            }
        )
        self.action_space = spaces.Discrete(self.places + len(self.files))
        self._episode, self._touches = {}, 0

    def _begin(self, rng: np.random.Generator) -> tuple[Any, dict[str, Any]]:
        self._episode, self._touches = self.draw_episode(rng), 0
        return self._empty_observation(), dict(self._episode)

    def draw_episode(self, rng: np.random.Generator) -> dict[str, Any]:
        """Draw an object, its size and its yaw: what ``info`` holds."""
        kind = int(rng.integers(len(self.files)))
        scale = self.files[kind].scale * float(np.exp(rng.uniform(*np.log(SIZES))))
        return {"object": kind, "scale": scale, "yaw": float(rng.uniform(0, 2 * np.pi))}

    def step(self, action: int) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Touch the object, or name it."""
        calls.require_reset(bool(self._episode))
        chosen, info = calls.check_action(action, int(self.action_space.n)), dict(self._episode)  # type: ignore[attr-defined]
        if chosen >= self.places:
            self._episode = {}
            return self._empty_observation(), float(chosen - self.places == info["object"]), True, False, info
        felt = self.feel(info["object"], info["scale"], info["yaw"], [chosen])
        error = self.np_random.normal(size=3) * self.noise
        observation = self._empty_observation()
        if felt.touched[0]:
            contact = self.felt_places(np.array([chosen]), felt.radius, error)[0]
            observation = {"touch": felt.images[0], "contact": contact, "touched": np.int64(1)}
        self._touches += 1
        cut = self._touches >= self.limit
        if cut:
            self._episode = {}
        return observation, -COST, False, cut, info

    def feel(self, kind: int, scale: float, yaw: float, places: "Sequence[int] | np.ndarray") -> Probe:
        """Touch an object of a size (m) and yaw (radians) at places (N,), the numbers of actions."""
        file, rows = self.files[kind], np.asarray(places)
        points, outward, radius, touched = self.approach(kind, scale, yaw, rows)
        background = self._optics.background.numpy()
        images = np.broadcast_to(background, (len(rows), *background.shape)).astype(np.uint8)
        near = np.flatnonzero(touched)
        if len(near):
            angle, depth = upright_angles(outward[near]), np.full(len(near), DEPTH)
            caster, profile = file.surface.caster, self.profile
            pressed = press(caster, points[near], outward[near], angle, depth, profile, scale)
            images[near] = self._optics.render(torch.from_numpy(pressed.displacement)).numpy()
        return Probe(images, radius, touched)

    def approach(
        self, kind: int, scale: "float | np.ndarray", yaw: "float | np.ndarray", places: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Find where the gel first meets an object of sizes and yaws (N,), or of one, at places (N,).

        Returns points and outward axes (N, 3) in the object's frame, metres, distances of the points from the
        vertical axis (N,), 0 where there is none, and whether there is one (N,).
        """
        file = self.files[kind]
        azimuth, height = self._direction(places)
        cos, sin = np.cos(yaw), np.sin(yaw)
        along, across = azimuth[:, 0] * cos + azimuth[:, 1] * sin, azimuth[:, 1] * cos - azimuth[:, 0] * sin
        outward = np.stack([along, across, 0 * along], 1)
        size = np.broadcast_to(np.asarray(scale, np.float64), len(places))[:, None]
        low = file.bounds[0, 2] * size[:, 0] / file.scale
        origins = outward * self._reach + np.stack([0 * height, 0 * height, height + low], 1)
        found, _ = file.surface.caster.first_hit(origins / size, -outward)
        distance = found.astype(np.float64) * size[:, 0]
        touched = distance < self._reach
        distance = np.where(touched, distance, self._reach)
        return origins - distance[:, None] * outward, outward, self._reach - distance, touched

    def felt_places(self, places: np.ndarray, radius: np.ndarray, error: np.ndarray) -> np.ndarray:
        """Return contacts (N, 3) float32 as they are observed, world frame, m, with errors (N, 3)."""
        azimuth, height = self._direction(places)
        box: spaces.Box = self.observation_space["contact"]  # type: ignore[index]
        place = np.stack([*(radius * azimuth.T[:2]), height], 1) + error
        return place.astype(np.float32).clip(box.low, box.high)

    def _direction(self, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the directions (N, 3) from which the gel comes, world frame, and its heights (N,), m."""
        turn = 2 * np.pi / AZIMUTHS * (places % AZIMUTHS)
        height = (places // AZIMUTHS + 0.5) / HEIGHTS * self._tallest
        return np.stack([np.cos(turn), np.sin(turn), 0 * turn], 1), height

    def _empty_observation(self) -> dict[str, Any]:
        background = self._optics.background.numpy().reshape(self.profile.height, self.profile.width, 3)
        nowhere = np.zeros(3, np.float32)
        return {"touch": background.astype(np.uint8), "contact": nowhere, "touched": np.int64(0)}


def upright_angles(outward: np.ndarray) -> np.ndarray:
    """Return the angles (N,) of `sensor_frames` at which the images of horizontal sensors are upright."""
    angles, _, _ = sensor_angles(outward, outward, np.broadcast_to([0.0, 0.0, 1.0], outward.shape))
    return angles


class Explorer:
    """Keeps a belief over objects, sizes and yaws, and knows where a touch tells most.

    Its table holds what touches at all places give for `SHAPES` drawn sizes and yaws of each object; turned
    by the azimuths of the environment, these are its hypotheses. The likelihood of a touch is normal in the
    radius of the contact and in the principal components of the image. Its two widths are those that name
    the objects of training episodes best.

    Parameters
    ----------
    env : ExploreEnv
    seed : int
        Of the sizes and yaws, of the training episodes and of samples of answers.
    shapes : int
    episodes : int
        To choose the widths on, of four random touches each.
    """

    def __init__(self, env: ExploreEnv, seed: int = 0, shapes: int = SHAPES, episodes: int = 150):
        self._env, self._rng = env, np.random.default_rng(seed)
        every, rng, sector = np.arange(env.places), self._rng, 2 * np.pi / AZIMUTHS
        felt = []
        for kind, file in enumerate(env.files):
            drawn = zip(rng.uniform(*_LOG_SIZES, size=shapes), rng.uniform(0, sector, shapes))
            poses = [(file.scale * float(np.exp(size)), float(yaw)) for size, yaw in drawn]
            felt += [env.feel(kind, *pose, every) for pose in poses]
        touched = np.stack([one.touched for one in felt])
        seen = _blocks(np.concatenate([one.images[one.touched] for one in felt]))
        self._mean = seen.mean(0)
        _, values, axes = np.linalg.svd(seen - self._mean, full_matrices=False)
        kept = min(COMPONENTS, int((values > 1e-6 * values[0]).sum()))
        self._axes = axes[:kept].T * (np.sqrt(len(seen)) / values[:kept])
        table = np.zeros((len(felt), env.places, 1 + kept), np.float32)
        table[..., 0] = np.stack([one.radius for one in felt])
        table[touched, 1:] = (seen - self._mean) @ self._axes
        self._answers, self._touched = _rotate(table), _rotate(touched)
        self._kinds = np.repeat(np.arange(len(env.files)), shapes * AZIMUTHS)
        self.widths = self._fit_widths(episodes)
        self.restart()

    def restart(self) -> None:
        """Forget what was touched: all hypotheses are as likely."""
        self._belief = np.full(len(self._kinds), 1 / len(self._kinds))

    @property
    def chances(self) -> np.ndarray:
        """Probabilities of the objects; (n,)."""
        return np.bincount(self._kinds, self._belief, len(self._env.files))

    def learn(self, place: int, observation: dict[str, Any]) -> None:
        """Take what a touch at a place gave into account."""
        belief = self._belief * np.exp(self._likelihood(place, *self._read(observation), self.widths))
        self._belief = belief / belief.sum()

    def next_place(self) -> int:
        """Return the place whose touch is expected to tell most about which object it is."""
        order, drawn = self._draw(HYPOTHESES), self._draw(SAMPLES)
        is_kind = (self._kinds[order, None] == np.arange(len(self._env.files))).astype(float)
        noise = self._rng.normal(size=(SAMPLES, self._answers.shape[2])) * self._scales(self.widths)
        left = np.empty(self._env.places)
        for place in range(self._env.places):
            answers, touched = self._answers[drawn, place] + noise, self._touched[drawn, place]
            log = self._log_likelihoods(answers, touched, place, order, self.widths)
            joint = np.exp(log - log.max(1, keepdims=True))
            after = joint @ is_kind / joint.sum(1, keepdims=True)
            left[place] = -(after * np.log(after.clip(1e-12))).sum(1).mean()
        return int(left.argmin())

    def _read(self, observation: dict[str, Any]) -> tuple[np.ndarray, bool]:
        """Return the radius and the components (1 + C,) of an observation, and whether it is a contact."""
        components = (_blocks(observation["touch"][None]) - self._mean) @ self._axes
        radius = np.hypot(*observation["contact"][:2].astype(float))
        return np.concatenate([[radius], components[0]]), bool(observation["touched"])

    def _draw(self, count: int) -> np.ndarray:
        """Draw hypotheses from the belief, evenly; (count,) rows."""
        marks = (np.arange(count) + self._rng.uniform()) / count
        return self._belief.cumsum().searchsorted(marks).clip(0, len(self._belief) - 1)

    def _scales(self, widths: tuple[float, float]) -> np.ndarray:
        return np.array([widths[0]] + [widths[1]] * (self._answers.shape[2] - 1))

    def _likelihood(
        self, place: int, answer: np.ndarray, touched: bool, widths: tuple[float, float]
    ) -> np.ndarray:
        every = np.arange(len(self._kinds))
        return self._log_likelihoods(answer[None], np.array([touched]), place, every, widths)[0]

    def _log_likelihoods(
        self, answers: np.ndarray, touched: np.ndarray, place: int, rows: np.ndarray,
        widths: tuple[float, float],
    ) -> np.ndarray:  # fmt: skip
        """Return logarithms of likelihoods of answers (M,), for hypotheses of some rows (R,); (M, R)."""
        sizes = self._scales(widths)
        a, b = answers / sizes, self._answers[rows, place] / sizes
        squares = (a * a).sum(1)[:, None] - 2 * a @ b.T + (b * b).sum(1)
        both = touched[:, None] & self._touched[rows, place]
        alike = touched[:, None] == self._touched[rows, place]
        # A contact that the table does not know counts as one far from all others.
        far = -0.5 * 9 * len(sizes)
        known = np.maximum(-0.5 * squares, far + np.log(MISMATCH))
        log = np.where(both, known, np.where(touched, far, 0.0)[:, None])
        return log + np.log(np.where(alike, 1 - MISMATCH, MISMATCH))

    def _fit_widths(self, episodes: int) -> tuple[float, float]:
        """Return the widths with the greatest likelihood of the right names in training episodes."""
        scores: dict[tuple[float, float], float] = {(a, b): 0.0 for a in WIDTHS[0] for b in WIDTHS[1]}
        env, count = self._env, len(self._env.files)
        for _ in range(episodes):
            kind = int(self._rng.integers(count))
            scale = env.files[kind].scale * float(np.exp(self._rng.uniform(*_LOG_SIZES)))
            places = self._rng.integers(env.places, size=4)
            felt = env.feel(kind, scale, float(self._rng.uniform(0, 2 * np.pi)), places)
            radius = abs(felt.radius + self._rng.normal(size=4) * env.noise)
            answers = np.c_[radius, (_blocks(felt.images) - self._mean) @ self._axes]
            for widths in scores:
                log = np.zeros(len(self._kinds))
                for place, answer, hit in zip(places, answers, felt.touched):
                    log += self._likelihood(place, answer, bool(hit), widths)
                belief = np.bincount(self._kinds, np.exp(log - log.max()), count)
                scores[widths] += float(np.log(belief[kind] / belief.sum() + 1e-6))
        return max(scores, key=lambda widths: scores[widths])


def explore(
    env: ExploreEnv, explorer: Explorer, threshold: float, seed: int, random: bool = False
) -> dict[str, Any]:
    """Play one episode; return whether the name was ``right``, the number of ``touches`` and the ``reward``.

    Touches until an object is as probable as ``threshold``, where the explorer expects most, or at random.
    """
    env.reset(seed=seed)
    explorer.restart()
    rng, touches, reward = np.random.default_rng([seed, 1]), 0, 0.0
    while explorer.chances.max() < threshold and touches < env.limit - 1:
        place = int(rng.integers(env.places)) if random else explorer.next_place()
        observation, earned, *_ = env.step(place)
        explorer.learn(place, observation)
        touches, reward = touches + 1, reward + earned
    _, earned, *_ = env.step(env.places + int(explorer.chances.argmax()))
    return {"right": earned > 0, "touches": touches, "reward": reward + earned}


def _blocks(images: np.ndarray) -> np.ndarray:
    """Return means of blocks of images (N, H, W, 3) in [0, 1]; (N, F)."""
    high, wide = (side // BLOCK for side in images.shape[1:3])
    cut = images[:, : high * BLOCK, : wide * BLOCK].reshape(len(images), high, BLOCK, wide, BLOCK, 3)
    return cut.mean((2, 4)).reshape(len(images), high * wide * 3) / 255


def _rotate(table: np.ndarray) -> np.ndarray:
    """Turn shapes of a table (P, places, ...) by all azimuths: (P AZIMUTHS, places, ...)."""
    grid = table.reshape(len(table), HEIGHTS, AZIMUTHS, *table.shape[2:])
    turned = np.stack([np.roll(grid, k, axis=2) for k in range(AZIMUTHS)], 1)
    return turned.reshape(len(table) * AZIMUTHS, *table.shape[1:])
