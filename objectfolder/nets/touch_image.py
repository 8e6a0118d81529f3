"""TouchNet ``image``: the paper's network (supplementary E), from a contact point and a pixel to its colour.

It memorises the contacts that it was trained on; it is here to compare with. It is a function of position
alone: all its contacts have one press depth and one angle.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from torch import nn

from objectfolder.errors import ObjectFolderError
from objectfolder.nets.fit import CurvePoint, fit
from objectfolder.nets.positional import PointwiseNetwork, with_half_weights
from objectfolder.nets.touch_config import ImageConfig

VAL_SAMPLES = 1 << 14

# Contacts whose depths (metres) or angles (radians) differ by less are alike: rounding.
_ALIKE = 1e-9


class ImageTouch(nn.Module):
    """Tactile images at points of the surface; mean grey until trained.

    Parameters
    ----------
    sensor : str
        Name of the profile that it has learnt; for information.
    image_size : (int, int)
        Rows and columns.
    press_depth, angle : float
        Of every contact that it has learnt, metres and radians.
    width, depth, point_octaves, pixel_octaves
        See `PointwiseNetwork`; the paper's net has eight layers of 256 channels.
    """

    def __init__(
        self,
        sensor: str,
        image_size: tuple[int, int],
        press_depth: float,
        angle: float,
        width: int,
        depth: int,
        point_octaves: int,
        pixel_octaves: int,
    ):
        super().__init__()
        self.config: dict[str, Any] = {
            "sensor": sensor,
            "image_size": list(image_size),
            "press_depth": press_depth,
            "angle": angle,
            "width": width,
            "depth": depth,
            "point_octaves": point_octaves,
            "pixel_octaves": pixel_octaves,
        }
        self.image_size = (int(image_size[0]), int(image_size[1]))
        self.press_depth, self.angle = float(press_depth), float(angle)
        self.network = PointwiseNetwork(width, depth, point_octaves, pixel_octaves, outputs=3)
        nn.init.zeros_(self.network.output.weight)
        nn.init.zeros_(self.network.output.bias)

    def forward(self, points: torch.Tensor, pixels: torch.Tensor) -> torch.Tensor:
        """Colours, -1 to 1, at (N, 3) points of the unit frame and (N,) flat pixels; (N, 3)."""
        return self.network(torch.cat([2 * points, _places(self.image_size, points.device)[pixels]], 1))

    @torch.no_grad()
    def images(self, points: np.ndarray) -> np.ndarray:
        """Tactile images at (N, 3) points of the unit frame; (N, H, W, 3) uint8."""
        height, width = self.image_size
        device = self.network.output.weight.device
        pixels = torch.arange(height * width, device=device)
        images = np.empty((len(points), height, width, 3), np.uint8)
        for image, point in zip(images, torch.from_numpy(np.asarray(points, np.float32)).to(device)):
            grey = (self(point.expand(len(pixels), 3), pixels) + 1) * 127.5
            image[:] = grey.round().clamp(0, 255).to(torch.uint8).view(height, width, 3).cpu().numpy()
        return images

    def to_tensors(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Tensors (weights as float16) and configuration."""
        return with_half_weights(self), dict(self.config)

    @classmethod
    def from_tensors(cls, tensors: dict[str, np.ndarray], config: dict[str, Any]) -> "ImageTouch":
        """Inverse of `to_tensors`."""
        net = cls(**config)
        net.load_state_dict({name: torch.from_numpy(np.array(value)) for name, value in tensors.items()})
        return net.eval()


def _places(image_size: tuple[int, int], device: torch.device) -> torch.Tensor:
    """Column and row of every pixel, each from -1 to 1; (H W, 2)."""
    rows, columns = (torch.linspace(-1, 1, size, device=device) for size in image_size)
    return torch.stack(torch.meshgrid(columns, rows, indexing="xy"), -1).flatten(0, 1)


def train_image(
    train: dict[str, np.ndarray],
    val: dict[str, np.ndarray],
    scale: float,
    sensor: str,
    config: ImageConfig,
    generator: torch.Generator,
    report: Callable[[CurvePoint], None] = lambda point: None,
    device: str | torch.device = "cpu",
) -> tuple[ImageTouch, list[CurvePoint]]:
    """Fit an `ImageTouch` to contacts.

    Parameters
    ----------
    train, val : dict
        As `objectfolder.touch.dataset.render_contacts` returns, all of one depth and one angle.
    scale : float
        Longest side, metres.
    sensor : str
        Name of the profile.
    config : ImageConfig
    generator : torch.Generator
        On the CPU.
    report : callable
        Called with each `CurvePoint`; losses are mean squared errors of images in [0, 1].
    device : str or torch.device
        Where to train; the net comes back on the CPU. The size of the paper takes a GPU.

    Raises
    ------
    ObjectFolderError
        If contacts differ in depth or angle.
    """
    press_depth, angle = (_one_value(name, train, val) for name in ("depths", "angles"))
    images = torch.from_numpy(train["images"])
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(int(torch.randint(2**31, (1,), generator=generator)))
        net = ImageTouch(
            sensor,
            (images.shape[1], images.shape[2]),
            press_depth,
            angle,
            config.width,
            config.depth,
            config.point_octaves,
            config.pixel_octaves,
        )
        # Starts from the mean colour; grey is far off.
        mean = images.double().mean((0, 1, 2)) / 127.5 - 1
        net.network.output.bias.data = mean.float()
    net = net.to(device)

    def gather(contacts: dict[str, np.ndarray]) -> tuple[torch.Tensor, torch.Tensor]:
        points = torch.from_numpy((contacts["points"] / scale).astype(np.float32))
        return points.to(device), torch.from_numpy(contacts["images"]).flatten(1, 2).to(device)

    def draw(shape: torch.Size, count: int) -> tuple[torch.Tensor, torch.Tensor]:
        rows, pixels = (torch.randint(size, (count,), generator=generator).to(device) for size in shape[:2])
        return rows, pixels

    def loss(
        points: torch.Tensor, grey: torch.Tensor, rows: torch.Tensor, pixels: torch.Tensor
    ) -> torch.Tensor:
        error = net(points[rows], pixels) - (grey[rows, pixels].float() / 127.5 - 1)
        return error.square().mean() / 4

    known, held_out = gather(train), gather(val)
    checked = draw(held_out[1].shape, VAL_SAMPLES)
    curve = fit(
        net,
        batch_loss=lambda: loss(*known, *draw(known[1].shape, config.batch)),
        val_loss=lambda: loss(*held_out, *checked).item(),
        steps=config.steps,
        learning_rate=config.learning_rate,
        report=report,
    )
    return net.cpu().eval(), curve


def _one_value(name: str, *splits: dict[str, np.ndarray]) -> float:
    values = np.concatenate([contacts[name] for contacts in splits])
    if np.ptp(values) > _ALIKE:
        field = {"depths": "depth", "angles": "angle"}[name]
        raise ObjectFolderError(
            f"contacts have {name} from {values.min():g} to {values.max():g}; "
            f"a net of kind image is a function of the point alone: give render_touch.{field} a value, "
            "or set train_touch.net: geometric"
        )
    return float(values[0])
