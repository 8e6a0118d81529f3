"""TouchNet ``image``: the paper's network (supplementary E), from a contact point and a pixel to its colour.

It memorises its training contacts and serves as a baseline. It is a function of position alone: all contacts
have the same press depth and angle.
"""

from typing import Any

import numpy as np
import torch
from torch import nn

from objectfolder.nets.positional import PointwiseNetwork
from objectfolder.nets.storage import OCTAVES, PAPERS, UNFILLED, NetKind, fill, halve_weights, real, whole


class ImageTouch(nn.Module):
    """Net from surface points to tactile images (rows, columns); mid-grey until trained.

    The name of the sensor profile it was trained on is for information; ``contact`` holds press depth and
    angle of all training contacts, metres and radians. For the sizes see `PointwiseNetwork`; the paper's net
    has eight layers of 256 channels.
    """

    def __init__(
        self,
        sensor: str,
        image_size: tuple[int, int],
        contact: tuple[float, float],
        width: int,
        depth: int,
        point_octaves: int,
        pixel_octaves: int,
    ):
        super().__init__()
        self.config: dict[str, Any] = {
            "sensor": sensor,
            "image_size": list(image_size),
            "press_depth": contact[0],
            "angle": contact[1],
            "width": width,
            "depth": depth,
            "point_octaves": point_octaves,
            "pixel_octaves": pixel_octaves,
        }
        self.image_size = (int(image_size[0]), int(image_size[1]))
        self.press_depth, self.angle = map(float, contact)
        self.network = PointwiseNetwork(width, depth, point_octaves, pixel_octaves, outputs=3)
        nn.init.zeros_(self.network.output.weight)
        nn.init.zeros_(self.network.output.bias)

    def forward(self, points: torch.Tensor, pixels: torch.Tensor) -> torch.Tensor:
        """Evaluate colours, -1 to 1, at (N, 3) points of the unit frame and (N,) flat pixels; (N, 3)."""
        return self.network(torch.cat([2 * points, _places(self.image_size, points.device)[pixels]], 1))

    @torch.no_grad()
    def images(self, points: np.ndarray) -> np.ndarray:
        """Render tactile images at (N, 3) points of the unit frame; (N, H, W, 3) uint8."""
        height, width = self.image_size
        device = self.network.output.weight.device
        pixels = torch.arange(height * width, device=device)
        images = np.empty((len(points), height, width, 3), np.uint8)
        for image, point in zip(images, torch.from_numpy(np.asarray(points, np.float32)).to(device)):
            grey = (self(point.expand(len(pixels), 3), pixels) + 1) * 127.5
            image[:] = grey.round().clamp(0, 255).to(torch.uint8).view(height, width, 3).cpu().numpy()
        return images

    def to_tensors(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Return tensors (weights as float16) and configuration."""
        return halve_weights(self), dict(self.config)

    @classmethod
    def from_tensors(cls, tensors: dict[str, np.ndarray], config: dict[str, Any]) -> "ImageTouch":
        """Invert `to_tensors`."""
        state = {name: torch.from_numpy(np.array(value)) for name, value in tensors.items()}
        others = {name: value for name, value in config.items() if name not in ("press_depth", "angle")}
        with UNFILLED:
            net = cls(contact=(config["press_depth"], config["angle"]), **others)
        return fill(net, state)


def _places(image_size: tuple[int, int], device: torch.device) -> torch.Tensor:
    """Return the column and row of every pixel, each from -1 to 1; (H W, 2)."""
    rows, columns = (torch.linspace(-1, 1, size, dtype=torch.float32, device=device) for size in image_size)
    return torch.stack(torch.meshgrid(columns, rows, indexing="xy"), -1).flatten(0, 1)


_SIZE = {
    "type": "array",
    "items": whole(1, 2048),
    "minItems": 2,
    "maxItems": 2,
    "description": "rows, columns",
}
_FIELDS = {
    "sensor": {"type": "string"},
    "image_size": _SIZE,
    "press_depth": real(0, 1, "metres"),
    "angle": {"type": "number", "description": "radians"},
    **PAPERS,
    "pixel_octaves": OCTAVES,
}
KINDS = {"image": NetKind(ImageTouch, "images", _FIELDS)}
