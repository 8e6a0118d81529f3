"""Name objects by touch from a belief: the trained baseline of ``ObjectFolder/Explore-v0``."""

import math
from typing import Any

import numpy as np

from objectfolder.envs.drop import SIZES
from objectfolder.envs.explore import AZIMUTHS, HEIGHTS, ExploreEnv

SHAPES = 48  #: sizes and yaws of each object in the table
COMPONENTS = 6  #: of tactile images
BLOCK = 5  #: pixels of an image that are averaged, each way
FAILS = 0.02  #: probability that a touch meets the object where the table says it does not, or the reverse
WIDTHS = (0.001, 0.002, 0.004), (0.15, 0.3, 0.6, 1.2)  #: of likelihoods that are tried: radius, m; components
SAMPLES = 40  #: answers that an expected gain is a mean of
HYPOTHESES = 1000  #: drawn from the belief, that it takes into account
_LOG_SIZES = math.log(SIZES[0]), math.log(SIZES[1])


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
        every, rng = np.arange(env.places), self._rng
        felt = [
            env.feel(kind, file.scale * float(np.exp(size)), float(yaw), every)
            for kind, file in enumerate(env.files)
            for size, yaw in zip(
                rng.uniform(*_LOG_SIZES, size=shapes), rng.uniform(0, 2 * np.pi / AZIMUTHS, shapes)
            )
        ]
        touched = np.stack([one.touched for one in felt])
        seen = _blocks(np.concatenate([one.images[one.touched] for one in felt]))
        self._mean = seen.mean(0)
        _, values, axes = np.linalg.svd(seen - self._mean, full_matrices=False)
        kept = min(COMPONENTS, int((values > 1e-6 * values[0]).sum()))
        self._axes = axes[:kept].T * (np.sqrt(len(seen)) / values[:kept])
        table = np.zeros((len(felt), env.places, 1 + kept), np.float32)
        table[..., 0] = np.stack([one.radius for one in felt])
        table[touched, 1:] = (seen - self._mean) @ self._axes
        self._answers, self._touched = _turned(table), _turned(touched)
        self._kinds = np.repeat(np.arange(len(env.files)), shapes * AZIMUTHS)
        self.widths = self._chosen(episodes)
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
        order, drawn = self._drawn(HYPOTHESES), self._drawn(SAMPLES)
        is_kind = (self._kinds[order, None] == np.arange(len(self._env.files))).astype(float)
        noise = self._rng.normal(size=(SAMPLES, self._answers.shape[2])) * self._sizes(self.widths)
        left = np.empty(self._env.places)
        for place in range(self._env.places):
            answers, touched = self._answers[drawn, place] + noise, self._touched[drawn, place]
            log = self._compared(answers, touched, place, order, self.widths)
            joint = np.exp(log - log.max(1, keepdims=True))
            after = joint @ is_kind / joint.sum(1, keepdims=True)
            left[place] = -(after * np.log(after.clip(1e-12))).sum(1).mean()
        return int(left.argmin())

    def _read(self, observation: dict[str, Any]) -> tuple[np.ndarray, bool]:
        """Return the radius and the components (1 + C,) of an observation, and whether it is a contact."""
        components = (_blocks(observation["touch"][None]) - self._mean) @ self._axes
        radius = np.hypot(*observation["contact"][:2].astype(float))
        return np.concatenate([[radius], components[0]]), bool(observation["touched"])

    def _drawn(self, count: int) -> np.ndarray:
        """Draw hypotheses from the belief, evenly; (count,) rows."""
        marks = (np.arange(count) + self._rng.uniform()) / count
        return self._belief.cumsum().searchsorted(marks).clip(0, len(self._belief) - 1)

    def _sizes(self, widths: tuple[float, float]) -> np.ndarray:
        return np.array([widths[0]] + [widths[1]] * (self._answers.shape[2] - 1))

    def _likelihood(
        self, place: int, answer: np.ndarray, touched: bool, widths: tuple[float, float]
    ) -> np.ndarray:
        every = np.arange(len(self._kinds))
        return self._compared(answer[None], np.array([touched]), place, every, widths)[0]

    def _compared(
        self,
        answers: np.ndarray,
        touched: np.ndarray,
        place: int,
        rows: np.ndarray,
        widths: tuple[float, float],
    ) -> np.ndarray:
        """Return logarithms of likelihoods of answers (M,), for hypotheses of some rows (R,); (M, R)."""
        sizes = self._sizes(widths)
        a, b = answers / sizes, self._answers[rows, place] / sizes
        squares = (a * a).sum(1)[:, None] - 2 * a @ b.T + (b * b).sum(1)
        both = touched[:, None] & self._touched[rows, place]
        alike = touched[:, None] == self._touched[rows, place]
        # A contact that the table does not know counts as one far from all others.
        far = -0.5 * 9 * len(sizes)
        log = np.where(
            both, np.maximum(-0.5 * squares, far + np.log(FAILS)), np.where(touched, far, 0.0)[:, None]
        )
        return log + np.log(np.where(alike, 1 - FAILS, FAILS))

    def _chosen(self, episodes: int) -> tuple[float, float]:
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
    env: ExploreEnv, explorer: Explorer, sure: float, seed: int, random: bool = False
) -> dict[str, Any]:
    """Play one episode; return whether the name was ``right``, the number of ``touches`` and the ``reward``.

    Touches until an object is as probable as ``sure``, where the explorer expects most, or at random.
    """
    env.reset(seed=seed)
    explorer.restart()
    rng, touches, reward = np.random.default_rng([seed, 1]), 0, 0.0
    while explorer.chances.max() < sure and touches < env.limit - 1:
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


def _turned(table: np.ndarray) -> np.ndarray:
    """Turn shapes of a table (P, places, ...) by all azimuths: (P AZIMUTHS, places, ...)."""
    grid = table.reshape(len(table), HEIGHTS, AZIMUTHS, *table.shape[2:])
    turned = np.stack([np.roll(grid, k, axis=2) for k in range(AZIMUTHS)], 1)
    return turned.reshape(len(table) * AZIMUTHS, *table.shape[1:])
