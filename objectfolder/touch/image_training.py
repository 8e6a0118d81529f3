"""Training of TouchNet ``image``."""

from collections.abc import Callable

import numpy as np
import torch

from objectfolder.base.errors import ObjectFolderError
from objectfolder.nets.fit import CurvePoint, Session, choose_part_size, fit_papers_net, sum_in_parts
from objectfolder.touch.image_net import ImageTouch
from objectfolder.touch.net_settings import ImageConfig, TouchConfig
from objectfolder.touch.profiles import SensorProfile

Split = dict[str, np.ndarray]
VAL_SAMPLES = 1 << 14
_PART = 1 << 12  # pixels whose activations are kept for a gradient
# Largest difference of depths (metres) or angles (radians) that is attributed to rounding.
_ALIKE = 1e-9


def train(
    train: dict[str, np.ndarray],
    val: dict[str, np.ndarray],
    scale: float,
    profile: SensorProfile,
    _surface: object,
    settings: TouchConfig,
    session: Session,
) -> tuple[ImageTouch, list[CurvePoint]]:
    """Train a net of this kind, as the stage asks."""
    return train_image(train, val, scale, profile.name, settings.image, session)


def train_image(
    train: Split, val: Split, scale: float, sensor: str, config: ImageConfig, session: Session
) -> tuple[ImageTouch, list[CurvePoint]]:
    """Fit an `ImageTouch` to contacts, as returned by `objectfolder.touch.truth.render_contacts`.

    ``scale`` is the longest side in metres, ``sensor`` the name of its profile. Losses of the curve are mean
    squared errors of images in [0, 1]. Raises ObjectFolderError if contacts differ in depth or angle.
    """
    device, generator = session.device, session.generator
    depth, angle = (_one_value(name, train, val) for name in ("depths", "angles"))
    images = torch.from_numpy(train["images"])
    with session.initialisation():
        net = ImageTouch(
            *(sensor, (images.shape[1], images.shape[2]), (depth, angle)),
            *(config.width, config.depth, config.point_octaves, config.pixel_octaves),
        )
        # Start from the mean colour, which is closer than grey.
        mean = train["images"].mean((0, 1, 2), dtype=np.float64) / 127.5 - 1
        net.network.output.bias.data = torch.from_numpy(mean).float()

    def gather(contacts: Split) -> tuple[torch.Tensor, torch.Tensor]:
        points = torch.from_numpy((contacts["points"] / scale).astype(np.float32))
        return points.to(device), torch.from_numpy(contacts["images"]).flatten(1, 2).to(device)

    def draw(shape: torch.Size, count: int) -> tuple[torch.Tensor, torch.Tensor]:
        rows, pixels = (torch.randint(size, (count,), generator=generator).to(device) for size in shape[:2])
        return rows, pixels

    def loss_of(points: torch.Tensor, grey: torch.Tensor) -> Callable[..., torch.Tensor]:
        def loss(rows: torch.Tensor, pixels: torch.Tensor) -> torch.Tensor:
            error = net(points[rows], pixels) - (grey[rows, pixels].float() / 127.5 - 1)
            return error.square().mean() / 4

        return loss

    known, held_out = gather(train), gather(val)
    loss, val_loss = loss_of(*known), loss_of(*held_out)
    checked = draw(held_out[1].shape, VAL_SAMPLES)
    part = choose_part_size(_PART, config.batch, device)

    def batch_loss() -> torch.Tensor:
        return sum_in_parts(loss, part, *draw(known[1].shape, config.batch))

    return net, fit_papers_net(net, batch_loss, lambda: val_loss(*checked).item(), config, session)


def _one_value(name: str, *splits: Split) -> float:
    values = np.concatenate([contacts[name] for contacts in splits])
    if np.ptp(values) > _ALIKE:
        field = {"depths": "depth", "angles": "angle"}[name]
        raise ObjectFolderError(
            f"contacts have {name} from {values.min():g} to {values.max():g}; "
            f"a net of kind image depends on the point alone: give render_touch.{field} a value, "
            "or set train_touch.net: geometric"
        )
    return float(values[0])
