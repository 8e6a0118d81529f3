"""Training of VisionNet ``osf``."""

from dataclasses import dataclass

import numpy as np
import torch

from objectfolder.base.errors import ObjectFolderError
from objectfolder.mesh.gridcodec import BOUND
from objectfolder.nets.fit import CurvePoint, Session, choose_part_size, fit_papers_net, sum_in_parts
from objectfolder.vision.cameras import Intrinsics, camera_rays
from objectfolder.vision.color import display_error, on_white
from objectfolder.vision.net_settings import OsfConfig, VisionConfig
from objectfolder.vision.osf_net import OsfNet, pixel_centres
from objectfolder.vision.visual_hull import visual_hull
from objectfolder.vision.volume import Rays

VAL_RAYS = 1 << 10  #: rays in the validation loss
_PART = 64  # rays whose activations are kept for a gradient; they hardly leave the cache


@dataclass(frozen=True)
class _Pixels:
    """Pixels of a split whose rays intersect the cube; all others are white."""

    origins: torch.Tensor  # (views, 3)
    lights: torch.Tensor  # (views, 3)
    view: torch.Tensor  # (R,) int32
    directions: torch.Tensor  # (R, 3)
    target: torch.Tensor  # (R, 3) sRGB on white

    def loss(
        self, net: OsfNet, index: torch.Tensor, generator: torch.Generator | None = None
    ) -> torch.Tensor:
        """Compute the mean squared errors of the coarse and the fine net, in sRGB; (2,)."""
        index = index.to(self.view.device)
        view = self.view[index]
        rays = Rays.through_cube(self.origins[view], self.directions[index], BOUND)
        seen = torch.stack(net(rays, self.lights[view], generator))
        return display_error(seen, self.target[index]).square().mean((1, 2))


def train(
    train: dict[str, np.ndarray],
    val: dict[str, np.ndarray],
    _surface: object,
    _scene: object,
    settings: VisionConfig,
    session: Session,
) -> tuple[OsfNet, list[CurvePoint]]:
    """Train a net of this kind, as the stage asks."""
    return train_osf(train, val, settings.osf, session)


def train_osf(
    train: dict[str, np.ndarray], val: dict[str, np.ndarray], config: OsfConfig, session: Session
) -> tuple[OsfNet, list[CurvePoint]]:
    """Fit an `OsfNet` to whole views; rays of a batch are drawn with replacement.

    Views: ``rgba`` (N, H, W, 4), ``camera_to_world`` (N, 4, 4), ``light`` (N, 3), ``focal``, ``center`` (N,
    2). Losses of the curve are mean squared errors in sRGB over rays that intersect the cube: the sum for
    both nets in training; in validation the fine net's, on `VAL_RAYS` rays. Raises ObjectFolderError if the
    images are tiles: what lies beside the object would stay unknown.
    """
    device, generator = session.device, session.generator
    pixels, held_out = _gather(train, device), _gather(val, device)
    sizes = "width", "depth", "branch_width", "branch_depth", "point_octaves", "direction_octaves"
    shape = {name: getattr(config, name) for name in sizes}
    with session.initialisation():
        net = OsfNet(config.coarse_samples, config.fine_samples, config.hull_cells, **shape)
    if net.hull is not None:
        net.hull = torch.from_numpy(visual_hull(train, config.hull_cells, BOUND))
    checked = torch.randperm(len(held_out.target), generator=generator)[:VAL_RAYS]

    part = choose_part_size(_PART, config.batch, device)

    def batch_loss() -> torch.Tensor:
        drawn = torch.randint(len(pixels.target), (config.batch,), generator=generator)
        return sum_in_parts(lambda rows: pixels.loss(net, rows, generator).sum(), part, drawn)

    def val_loss() -> float:
        sums = [held_out.loss(net, rows)[1].item() * len(rows) for rows in checked.split(part)]
        return sum(sums) / len(checked)

    return net, fit_papers_net(net, batch_loss, val_loss, config, session)


def _gather(views: dict[str, np.ndarray], device: str | torch.device) -> _Pixels:
    height, width = views["rgba"].shape[1:3]
    intrinsics = Intrinsics(width, height, float(views["focal"]))
    if (views["center"] != (intrinsics.cx, intrinsics.cy)).any():
        raise ObjectFolderError(
            f"the net osf learns from whole views, not from tiles of {width} x {height} pixels: set in "
            "params.yaml render_views.tile to null, train to 120, val to 8 and train_samples to 16"
        )
    centres = pixel_centres(intrinsics)
    view, directions, targets = [], [], []
    for i, (rgba, pose) in enumerate(zip(views["rgba"], views["camera_to_world"])):
        origin, direction = map(torch.from_numpy, camera_rays(pose, intrinsics, centres))
        rays = Rays.through_cube(origin, direction, BOUND)
        met = rays.far > rays.near
        view.append(torch.full((int(met.sum()),), i, dtype=torch.int32))
        directions.append(direction[met])
        targets.append(on_white(torch.from_numpy(rgba.reshape(-1, 4).astype(np.float32)))[met])
    return _Pixels(
        torch.from_numpy(views["camera_to_world"][:, :3, 3].astype(np.float32)).to(device),
        torch.from_numpy(views["light"].astype(np.float32)).to(device),
        *(torch.cat(parts).to(device) for parts in (view, directions, targets)),
    )
