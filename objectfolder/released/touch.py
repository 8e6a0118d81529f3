"""Readers of the TouchNets of released files."""

import numpy as np
import torch
from torch.nn.functional import interpolate

from objectfolder.nets.released.network import Frame, ReleasedNetwork, build_network
from objectfolder.nets.released.touch import APEX, DEPTH_SIZE, DEPTHS, PIXEL, ReleasedDepth, ReleasedImage
from objectfolder.released.audio import box
from objectfolder.released.checkpoint import ReleasedDict
from objectfolder.released.encoding import network
from objectfolder.touch.profiles import SensorProfile

PRESS_DEPTH = 0.001  #: m, assigned to images of 1.0, whose true depth is unknown; the default of queries
_PROBES = 64  # contacts to estimate the untouched gel from
_STRIDE = 4  # pixel stride of the estimate
_RARE = 0.9  # quantile of the probes' depths


def image_net(touch: ReleasedDict, frame: Frame, bounds: np.ndarray) -> ReleasedImage:
    """Read a TouchNet of ObjectFolder 1.0.

    Parameters
    ----------
    bounds : (2, 3) array
        Bounds of the object in the file's coordinates.

    Raises
    ------
    ObjectFolderError
        If an entry is missing or not as documented.
    """
    net = build_network(network(touch.state("model_state_dict"), 5, 3), 5)
    config = {
        "frame": frame.to_dict(),
        "coordinates": [float(bounds.min()), float(bounds.max())],
        "press_depth": PRESS_DEPTH,
        "angle": 0.0,
        "sensor": "tacto_digit",
    }
    return ReleasedImage(net, config)


def depth_net(
    touch: ReleasedDict, frame: Frame, profile: SensorProfile, gel: np.ndarray | None = None
) -> ReleasedDepth:
    """Read a TouchNet of ObjectFolder 2.0.

    Parameters
    ----------
    profile : SensorProfile
        Sensor that renders images from the depth maps.
    gel : (120, 160) array, optional
        The untouched gel as the released code stores it (``calibs/depth_bg.npy``): heights in pixels.
        Default: the 90th percentile of the depths of contacts across the object, pixel by pixel.

    Raises
    ------
    ObjectFolderError
        If an entry is missing or not as documented.
    """
    net = build_network(network(touch.state("model_state_dict"), 9, 1), 9)
    config = {"frame": frame.to_dict(), "bounds": box(touch), "sensor": profile.to_dict()}
    depth = _untouched(net) if gel is None else torch.from_numpy(APEX - PIXEL * np.asarray(gel, np.float64))
    return ReleasedDepth(net, depth.float(), config)


@torch.no_grad()
def _untouched(net: ReleasedNetwork) -> torch.Tensor:
    """Estimate the depth map of the untouched gel from the lightest contacts at random places; (120, 160)."""
    rng = np.random.default_rng(0)
    places = torch.from_numpy(rng.random((_PROBES, 3)).astype(np.float32))
    rows, columns = (torch.linspace(0, 1, n // _STRIDE) for n in DEPTH_SIZE)
    pixels = torch.stack(torch.meshgrid(rows, columns, indexing="ij"), -1).flatten(0, 1)
    upright = torch.tensor([0.0, 1.0, 0.0, 0.0])  # no tilt, azimuth 0, the lightest press
    depths = torch.stack(
        [
            net(torch.cat([torch.cat([place, upright]).expand(len(pixels), -1), pixels], 1))[:, 0]
            for place in places
        ]
    )
    low = depths.quantile(_RARE, 0).view(1, 1, len(rows), len(columns))
    full = interpolate(low, DEPTH_SIZE, mode="bilinear", align_corners=True)[0, 0]
    return full * (DEPTHS[1] - DEPTHS[0]) + DEPTHS[0]
