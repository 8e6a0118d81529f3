"""TouchNets of released ObjectFolder files: 1.0 predicts the image of a contact, 2.0 its depth map."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import torch
from torch.nn.functional import grid_sample

from objectfolder.base.checks import refuse_rows
from objectfolder.nets.released_network import (
    Frame,
    ReleasedNetwork,
    build_network,
    float_tensors,
    stored_tensors,
)
from objectfolder.sound.released_gains import checked_bounds
from objectfolder.touch.camera import ray_directions
from objectfolder.touch.gel import GAP
from objectfolder.touch.optics import Optics
from objectfolder.touch.profiles import SensorProfile
from objectfolder.touch.simulate import Touches, contacts_of

IMAGE_SIZE = (160, 120)  #: rows and columns of an image of 1.0
DEPTH_SIZE = (120, 160)  #: rows and columns of a depth map of 2.0
MAX_TILT = math.radians(15)
PRESS_DEPTHS = (0.0005, 0.002)  #: m
DEPTHS = (0.0339, 0.04)  #: m from the camera, represented by outputs 0 and 1
APEX = 0.04  #: m from the camera to the apex of the untouched gel
PIXEL = 0.0001245  #: m on the gel
CONTACT = 0.2  #: minimum indentation of a pixel in contact, relative to the press depth
_ROUNDING = 1e-6
_CHUNK = 4096  # pixels evaluated at once: their activations stay in the cache


class ReleasedImage:
    """Net from (x, y, z, row, column), all from -1 to 1, to the colour of a tactile image.

    ``config`` holds ``frame``; ``coordinates`` (low, high): a released coordinate c is mapped to 2 (c - low)
    / high - 1, as in the original, one pair for all axes; ``press_depth`` and ``angle``, assigned to every
    image. The original takes low and high from the queried points, so that an image depends on the other
    points of the query; here they are fixed. The press depth of its training is unknown.
    """

    def __init__(self, network: ReleasedNetwork, config: dict[str, Any]):
        self.network = network
        self.config = config
        self.frame = Frame.from_dict(config["frame"])
        self.press_depth, self.angle = float(config["press_depth"]), float(config["angle"])
        self._low, self._high = map(float, config["coordinates"])
        if not math.isfinite(self._low) or not math.isfinite(self._high) or self._high == 0:
            raise ValueError(f"coordinates {config['coordinates']}")
        if len(network.output.weight) != 3:
            raise ValueError(f"{len(network.output.weight)} colour channels, expected 3")
        self._pixels = torch.from_numpy(2 * _places(IMAGE_SIZE) - 1).float()

    def to(self, device: str | torch.device) -> "ReleasedImage":
        """Move to a device and return self."""
        self.network, self._pixels = self.network.to(device), self._pixels.to(device)
        return self

    @torch.no_grad()
    def images(self, points: np.ndarray) -> np.ndarray:
        """Render tactile images at (N, 3) points of the unit frame; (N, 160, 120, 3) uint8."""
        x = 2 * (self.frame.released(points) - self._low) / self._high - 1
        out = np.empty((len(x), *IMAGE_SIZE, 3), np.uint8)
        for image, point in zip(out, torch.from_numpy(x).float().to(self._pixels)):
            grey = (evaluate_pixels(self.network, point, self._pixels) + 1) / 2 * 255
            image[:] = grey.round().clamp(0, 255).to(torch.uint8).view(*IMAGE_SIZE, 3).cpu().numpy()
        return out

    def to_tensors(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Return tensors and configuration for storing."""
        return stored_tensors(self.network), dict(self.config)

    @classmethod
    def from_tensors(cls, tensors: dict[str, np.ndarray], config: dict[str, Any]) -> "ReleasedImage":
        """Invert `to_tensors`."""
        return cls(build_network(float_tensors(tensors), 5), dict(config))


class ReleasedDepth:
    """Net from contacts to depth maps, and simulation of a sensor pressed into them.

    The network maps (x, y, z, tilt, cos azimuth, sin azimuth, press depth, row, column) to a depth;
    ``untouched`` (120, 160) is the depth map of the untouched gel, metres. ``config`` holds ``frame``;
    ``bounds`` (2, 3), the released coordinates that inputs 0 and 1 represent; ``sensor``, a profile.
    """

    def __init__(self, network: ReleasedNetwork, untouched: torch.Tensor, config: dict[str, Any]):
        self.network = network
        self.untouched = untouched
        self.config = config
        self.frame = Frame.from_dict(config["frame"])
        self._bounds = checked_bounds(config["bounds"])
        if len(network.output.weight) != 1 or tuple(untouched.shape) != DEPTH_SIZE:
            raise ValueError(f"{len(network.output.weight)} depths, gel of {tuple(untouched.shape)}")
        self._pixels = torch.from_numpy(_places(DEPTH_SIZE)).float()
        self.profile = SensorProfile.from_dict(config["sensor"], stored=True)
        self._optics: dict[SensorProfile, Optics] = {}

    def to(self, device: str | torch.device) -> "ReleasedDepth":
        """Move the net to a device and return self; sensors are simulated on the CPU."""
        self.network, self._pixels = self.network.to(device), self._pixels.to(device)
        return self

    @torch.no_grad()
    def depth_maps(
        self, points: np.ndarray, depths: np.ndarray, tilts: np.ndarray, azimuths: np.ndarray
    ) -> np.ndarray:
        """Evaluate the original's depth maps, metres from the camera; (N, 120, 160) float32.

        At points (N, 3), unit frame, for press depths (N,), metres, tilts and azimuths (N,), theta and phi of
        the release, radians. Raises ObjectFolderError if a depth or tilt is outside the net's training range.
        """
        self.require(depths, tilts)
        low, high = self._bounds
        place = (self.frame.released(points) - low) / (high - low)
        pressed = (depths - PRESS_DEPTHS[0]) / (PRESS_DEPTHS[1] - PRESS_DEPTHS[0])
        x = np.column_stack([place, tilts / MAX_TILT, np.cos(azimuths), np.sin(azimuths), pressed])
        maps = np.empty((len(x), *DEPTH_SIZE), np.float32)
        for out, row in zip(maps, torch.from_numpy(x).float().to(self._pixels)):
            depth = evaluate_pixels(self.network, row, self._pixels).view(*DEPTH_SIZE)
            out[:] = depth.cpu().numpy() * (DEPTHS[1] - DEPTHS[0]) + DEPTHS[0]
        return maps

    def require(self, depths: np.ndarray, tilts: np.ndarray) -> None:
        """Raise ObjectFolderError unless press depths and tilts are in the net's training range."""
        for name, values, (low, high) in (("depth", depths, PRESS_DEPTHS), ("tilt", tilts, (0.0, MAX_TILT))):
            known = (values >= low - _ROUNDING) & (values <= high + _ROUNDING)
            refuse_rows(name, ~known, values, f"; the released net was trained on {low:g} to {high:g}")

    def press_range(self, profile: SensorProfile) -> tuple[float, float]:
        """Return the press depths of a sensor that the net was trained on, metres; without any, the net's."""
        (low, high), (least, most) = profile.press_depth, PRESS_DEPTHS
        found = max(low, least), min(high, most)
        return found if found[0] <= found[1] else PRESS_DEPTHS

    def touches(
        self,
        points: np.ndarray,
        depths: np.ndarray,
        tilts: np.ndarray,
        azimuths: np.ndarray,
        profile: SensorProfile | None = None,
    ) -> Iterator[Touches]:
        """Press a gel, by default the stored sensor's, into `depth_maps`; yield one contact at a time."""
        profile = profile or self.profile
        for row in [slice(i, i + 1) for i in range(len(points))] or [slice(0, 0)]:
            maps = self.depth_maps(points[row], depths[row], tilts[row], azimuths[row])
            height = self.heights(maps, depths[row], profile)
            found = contacts_of(height, np.zeros(len(height)), profile)
            images = self.draw_gel(found.displacement, profile)
            yield Touches(**vars(found), images=images, profile=profile)

    def draw_gel(self, displacement: np.ndarray, profile: SensorProfile) -> np.ndarray:
        """Return a sensor's images (N, H, W, 3) of a gel displaced by (N, H, W) metres."""
        if profile not in self._optics:
            self._optics[profile] = Optics(profile)
        return self._optics[profile].render(torch.from_numpy(displacement)).numpy()

    def heights(self, maps: np.ndarray, depths: np.ndarray, profile: SensorProfile) -> np.ndarray:
        """Compute heightmaps relative to a profile's undeformed gel; (N, H, W) float32.

        The convention is that of `contact.heightmaps`. As in the original, a pixel is in contact if it
        indents the gel by more than `CONTACT` of the press depth. The depth map is upright and centred in the
        sensor's image; pixels outside it are not in contact.
        """
        past = self.untouched.numpy() - maps
        touched = past > CONTACT * np.asarray(depths)[:, None, None]
        rays = ray_directions(profile) * profile.camera_to_gel
        rows, columns = DEPTH_SIZE
        x, y = -rays[..., 1] / (PIXEL * (columns - 1) / 2), -rays[..., 2] / (PIXEL * (rows - 1) / 2)
        grid = torch.from_numpy(np.stack([x, y], -1)).float().expand(len(maps), -1, -1, -1)
        both = torch.from_numpy(np.stack([past * touched, touched], 1)).float()
        height, share = grid_sample(both, grid, align_corners=True).unbind(1)
        gap = GAP * profile.elastomer_thickness
        return torch.where(share > 0.5, height.clamp(0, profile.max_indentation), -gap).numpy()

    def to_tensors(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Return tensors and configuration for storing."""
        return {"untouched": self.untouched.numpy(), **stored_tensors(self.network)}, dict(self.config)

    @classmethod
    def from_tensors(cls, tensors: dict[str, np.ndarray], config: dict[str, Any]) -> "ReleasedDepth":
        """Invert `to_tensors`."""
        state = float_tensors(tensors)
        untouched = state.pop("untouched")
        return cls(build_network(state, 9), untouched, dict(config))


def evaluate_pixels(network: ReleasedNetwork, row: torch.Tensor, pixels: torch.Tensor) -> torch.Tensor:
    """Evaluate a network at one contact and (P, 2) pixels; (P, outputs)."""
    parts = [network(torch.cat([row.expand(len(part), -1), part], 1)) for part in pixels.split(_CHUNK)]
    return torch.cat(parts)


def _places(size: tuple[int, int]) -> np.ndarray:
    """Return the row and column of every pixel, each from 0 to 1; (H W, 2) float64."""
    axes = [np.arange(n) / (n - 1) for n in size]
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 2)
