"""Explore: an object of unknown size and direction stands on a table unseen; name it by a few touches."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces

from objectfolder.checks import finite_number, whole_number
from objectfolder.envs.calls import KEPT, discrete_action, no_options, opened, started
from objectfolder.envs.drop import SIZES
from objectfolder.envs.fingers import sensor_angles
from objectfolder.errors import ObjectFolderError
from objectfolder.objectfile.file import ObjectFile
from objectfolder.touch.optics import Optics
from objectfolder.touch.profiles import SensorProfile, load_profile
from objectfolder.touch.simulate import press

AZIMUTHS, HEIGHTS = 12, 6  #: directions and heights from which the gel comes
DEPTH = 0.001  #: of a press, m
PRICE = 0.05  #: of a touch


@dataclass(frozen=True)
class Probed:
    """What touches of one object give, before the noise of the hand."""

    images: np.ndarray  #: (N, H, W, 3) uint8; untouched ones where the gel meets nothing
    radius: np.ndarray  #: (N,) m, of the contact from the vertical axis; 0 where there is none
    touched: np.ndarray  #: (N,) bool


class ExploreEnv(gymnasium.Env[dict[str, Any], int]):
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

    Raises
    ------
    ObjectFolderError
        If an argument is wrong, or on a step before a reset or with a wrong action.
    """

    metadata = {"render_modes": []}  # noqa: RUF012 - as the base class has it

    def __init__(
        self,
        objects: "str | ObjectFile | Sequence[str | ObjectFile]" = ("mug", "die", "bell"),
        noise: float = 0.001,
        limit: int = 30,
        sensor: "str | SensorProfile" = "digit",
        reduction: int = 4,
    ):
        self.files = opened(objects)
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
        self._profile = replace(full, height=height, width=width)
        self._optics = Optics(self._profile)
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
        self.action_space = spaces.Discrete(self.places + len(self.files))  # type: ignore[assignment]
        self._standing: dict[str, Any] = {}
        self._touches = 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Put an object on the table."""
        no_options(options)
        super().reset(seed=seed)
        rng = self.np_random
        kind = int(rng.integers(len(self.files)))
        scale = self.files[kind].scale * float(np.exp(rng.uniform(*np.log(SIZES))))
        self._standing = {"object": kind, "scale": scale, "yaw": float(rng.uniform(0, 2 * np.pi))}
        self._touches = 0
        return self._untouched(), dict(self._standing)

    def step(self, action: int) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Touch the object, or name it."""
        started(bool(self._standing))
        chosen, info = discrete_action(action, int(self.action_space.n)), dict(self._standing)  # type: ignore[attr-defined]
        if chosen >= self.places:
            self._standing = {}
            return self._untouched(), float(chosen - self.places == info["object"]), True, False, info
        felt = self.feel(info["object"], info["scale"], info["yaw"], [chosen])
        error = self.np_random.normal(size=3) * self.noise
        observation = self._untouched()
        if felt.touched[0]:
            azimuth, height = self._direction(np.array([chosen]))
            place = np.array([*(felt.radius[0] * azimuth[0, :2]), height[0]]) + error
            box: spaces.Box = self.observation_space["contact"]  # type: ignore[index]
            observation = {
                "touch": felt.images[0],
                "contact": place.astype(np.float32).clip(box.low, box.high),
                "touched": np.int64(1),
            }
        self._touches += 1
        cut = self._touches >= self.limit
        if cut:
            self._standing = {}
        return observation, -PRICE, False, cut, info

    def feel(self, kind: int, scale: float, yaw: float, places: "Sequence[int] | np.ndarray") -> Probed:
        """Touch an object of a size (m) and yaw (radians) at places (N,), the numbers of actions."""
        file, rows = self.files[kind], np.asarray(places)
        azimuth, height = self._direction(rows)
        cos, sin = np.cos(yaw), np.sin(yaw)
        outward = azimuth @ np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])  # object frame
        low = file.bounds[0, 2] * scale / file.scale
        origins = outward * self._reach + np.stack([0 * height, 0 * height, height + low], 1)
        found, _ = file.surface.caster.first_hit(origins / scale, -outward)
        distance = found.astype(np.float64) * scale
        touched = distance < self._reach
        background = self._optics.background.numpy()
        images = np.broadcast_to(background, (len(rows), *background.shape)).astype(np.uint8)
        near = np.flatnonzero(touched)
        if len(near):
            points = origins[near] - distance[near, None] * outward[near]
            up = np.broadcast_to([0.0, 0.0, 1.0], points.shape)
            angle, _, _ = sensor_angles(outward[near], outward[near], up)
            depth = np.full(len(near), DEPTH)
            caster, profile = file.surface.caster, self._profile
            pressed = press(caster, points, outward[near], angle, depth, profile, scale)
            images[near] = self._optics.render(torch.from_numpy(pressed.displacement)).numpy()
        return Probed(images, np.where(touched, self._reach - distance, 0.0), touched)

    def _direction(self, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the directions (N, 3) from which the gel comes, world frame, and its heights (N,), m."""
        turn = 2 * np.pi / AZIMUTHS * (places % AZIMUTHS)
        height = (places // AZIMUTHS + 0.5) / HEIGHTS * self._tallest
        return np.stack([np.cos(turn), np.sin(turn), 0 * turn], 1), height

    def _untouched(self) -> dict[str, Any]:
        background = self._optics.background.numpy().reshape(self._profile.height, self._profile.width, 3)
        return {
            "touch": background.astype(np.uint8),
            "contact": np.zeros(3, np.float32),
            "touched": np.int64(0),
        }

    def __reduce__(self) -> tuple[Any, ...]:
        state = {name: getattr(self, name) for name in ("_standing", "_touches", *KEPT)}
        return type(self), self._arguments, state
