"""Readers of the VisionNets of released files."""

import math
from typing import Any

import numpy as np
import torch

from objectfolder.nets.positional import SKIP
from objectfolder.nets.released.kilo import MARGIN, MAX_CELLS, ReleasedKilo
from objectfolder.nets.released.vision import MAX_SAMPLES, March, ReleasedNerf, build_scattering
from objectfolder.nets.vision_osf import ScatteringFunction
from objectfolder.released.checkpoint import ReleasedDict
from objectfolder.released.encoding import DEPTH, by_number, by_octave, octaves_of, trunk

#: Ray marching settings, fixed in the released code of 1.0.
MARCH = March(near=0.01, far=4.0, samples=64, more=128, inverse=False)

# Settings that make the released code render in a way that is not supported here.
_UNKNOWN = (
    *("no_color_sigmoid", "use_view_independent_color", "use_hard_parameter_sharing_for_color"),
    *("use_global_coordinates", "use_single_net", "crop_to_global_domain", "visualize_global_domain"),
    "render_debug_network_color_map",
)


def nerf_net(vision: ReleasedDict, crop: float | None = None) -> ReleasedNerf:
    """Read a VisionNet of ObjectFolder 1.0.

    Raises
    ------
    ObjectFolderError
        If an entry is missing or not as documented; all functions here raise it.
    """
    keys = {"coarse": "network_fn_state_dict", "fine": "network_fine_state_dict"}
    nets = {name: _net(vision.state(key)) for name, key in keys.items()}
    return ReleasedNerf(nets, MARCH, crop)


def configured_net(vision: ReleasedDict, crop: float | None = None) -> ReleasedNerf | ReleasedKilo:
    """Read a VisionNet of ObjectFolder 2.0; its ``cfg`` holds the rendering settings."""
    cfg = vision.part("cfg")
    state = vision.state("model_state_dict")
    first = state.values.get("pts_linears.0.weight")
    if isinstance(first, torch.Tensor) and first.ndim == 3:
        return _kilo(vision, cfg, state)
    march = _march(cfg, refine=True)
    refeed = cfg.setting("refeed_position_index")
    if refeed not in (None, SKIP):
        raise cfg.wrong("refeed_position_index", repr(refeed)[:40], f"{SKIP} or 'None'")
    depth = cfg.integer("num_hidden_layers", 1, 32)
    parts = {"coarse": "model_coarse.", "fine": "model_fine."} if march.more else {"fine": ""}
    nets = {name: _net(state.below(p) if p else state, refeed == SKIP, depth) for name, p in parts.items()}
    for name, net in nets.items():
        expected = (cfg.integer("num_frequencies", 0, 64), cfg.integer("num_frequencies_direction", 0, 64))
        if net.octaves != expected:
            raise cfg.wrong("num_frequencies", f"{expected}", f"{net.octaves}, as the {name} net has them")
    return ReleasedNerf(nets, march, crop)


def _march(cfg: ReleasedDict, refine: bool) -> March:
    for name in _UNKNOWN:
        if cfg.setting(name):
            raise cfg.wrong(name, "set", "it to be unset, since its way of rendering is not supported")
    if not cfg.setting("blender_white_background"):
        raise cfg.wrong("blender_white_background", "not set", "true: images on white")
    near, far = cfg.number("near"), cfg.number("far")
    if not 0 < near < far:
        raise cfg.wrong("near", f"{near:g}", f"a positive number below far, {far:g}")
    samples = cfg.integer("num_samples_per_ray", 4, MAX_SAMPLES)
    more = cfg.integer("num_importance_samples_per_ray", 0, MAX_SAMPLES)
    if more and not refine:
        raise cfg.wrong("num_importance_samples_per_ray", f"{more}", "0 in a file with a grid of nets")
    return March(near, far, samples, more, bool(cfg.setting("llff_lindisp")))


def _net(state: ReleasedDict, refeed: bool = True, depth: int = DEPTH) -> ScatteringFunction:
    """Read a network with point, view and light as inputs."""
    tensors, octaves = trunk(state, 3, "trunk.", refeed, depth)
    width = len(tensors["trunk.hidden.0.weight"])
    # Layer names of the released code, or those of the paper's description.
    bottleneck = "bottleneck_linear" if "bottleneck_linear.weight" in state else "feature_linear"
    views = "views_lights_linears.0" if "views_lights_linears.0.weight" in state else "views_linears.0"
    if f"{bottleneck}.weight" not in state:
        bottleneck = "bottleneck_linear"
    if f"{views}.weight" not in state:
        views = "views_lights_linears.0"
    joint = state.tensor(f"{views}.weight", None, None)
    branch, channels = len(joint), joint.shape[1] - width
    direction_octaves = octaves_of(state, f"{views}.weight", max(channels, 0), 6)
    order = by_octave(3, direction_octaves)
    order = np.concatenate([np.arange(width), width + order, width + len(order) + order])
    tensors["branch.hidden.0.weight"] = joint[:, order]
    tensors["branch.hidden.0.bias"] = state.tensor(f"{views}.bias", branch)
    for ours, theirs, shape in (
        ("density", "alpha_linear", (1, width)),
        ("bottleneck", bottleneck, (width, width)),
        ("fraction", "rgb_linear", (3, branch)),
    ):
        tensors[f"{ours}.weight"] = state.tensor(f"{theirs}.weight", *shape)
        tensors[f"{ours}.bias"] = state.tensor(f"{theirs}.bias", shape[0])
    return build_scattering(tensors, octaves, direction_octaves)


def _kilo(vision: ReleasedDict, cfg: ReleasedDict, state: ReleasedDict) -> ReleasedKilo:
    if not cfg.setting("late_feed_direction"):
        raise cfg.wrong("late_feed_direction", "not set", "true")
    if cfg.setting("refeed_position_index") is not None:
        raise cfg.wrong("refeed_position_index", "set", "'None' in a file with a grid of nets")
    if cfg.setting("nonlinearity", "relu") != "relu":
        raise cfg.wrong("nonlinearity", repr(cfg.values["nonlinearity"])[:40], "'relu'")
    march = _march(cfg, refine=False)
    grid = _sizes(cfg, "fixed_resolution", MAX_CELLS)
    corners = [cfg.numbers(f"global_domain_{end}", 3) for end in ("min", "max")]
    if not (corners[0] + 2 * MARGIN < corners[1]).all():
        raise cfg.wrong("global_domain_min", f"{corners[0].tolist()}", f"below {corners[1].tolist()}")
    octaves = tuple(cfg.integer(f"num_frequencies{what}", 0, 64) for what in ("", "_direction", "_light"))
    count = math.prod(grid)
    point, view, light = (3 * (1 + 2 * n) for n in octaves)
    voxels, occupied = grid, torch.ones(count, dtype=torch.bool)
    if "occupancy_grid" in vision and vision.values["occupancy_grid"] is not None:
        voxels = _sizes(cfg.part("occupancy"), "resolution", 1 << 30)
        occupied = torch.from_numpy(vision.mask("occupancy_grid", math.prod(voxels)))
    cells = _asked(occupied, voxels, grid)
    width = cfg.integer("hidden_layer_size", 1, 4096)
    branch = cfg.integer("direction_layer_size", 1, 4096)
    depth = cfg.integer("num_hidden_layers", 1, 32)
    names = {f"points.{i}": (f"pts_linears.{i}", point if i == 0 else width, width) for i in range(depth)}
    names |= {
        "density": ("alpha_linear", width, 1),
        "feature": ("feature_linear", width, width),
        "direction": ("direction_layer", width + view + light, branch),
        "color": ("rgb_linear", branch, 3),
    }
    orders = {
        "points.0": by_number(3, octaves[0]),
        "direction": np.concatenate(
            [
                np.arange(width),
                width + by_number(3, octaves[1]),
                width + view + by_number(3, octaves[2]),
            ]
        ),
    }
    weights: dict[str, Any] = {}
    for ours, (theirs, inputs, outputs) in names.items():
        weight = state.tensor(f"{theirs}.weight", count, inputs, outputs)[cells]
        weights[f"{ours}.weight"] = weight[:, orders[ours]] if ours in orders else weight
        weights[f"{ours}.bias"] = state.tensor(f"{theirs}.bias", count, outputs)[cells]
    box = [corner.tolist() for corner in corners]
    return ReleasedKilo(weights, cells, occupied, march, grid, voxels, box, octaves)


def _asked(occupied: torch.Tensor, voxels: tuple[int, ...], grid: tuple[int, ...]) -> torch.Tensor:
    """Return the cells that overlap an occupied voxel; the networks of the others are never evaluated."""
    # A cell covers the voxels from one end to the other; one more on each side allows for rounding.
    mask = occupied.view(voxels)
    for axis, (fine, coarse) in enumerate(zip(voxels, grid)):
        ends = [
            (max(math.floor(i * fine / coarse) - 1, 0), min(math.ceil((i + 1) * fine / coarse) + 1, fine))
            for i in range(coarse)
        ]
        mask = torch.stack([mask.narrow(axis, a, b - a).any(axis) for a, b in ends], axis)
    return mask.flatten().nonzero()[:, 0]


def _sizes(part: ReleasedDict, key: str, limit: int) -> tuple[int, int, int]:
    values = part.numbers(key, 3)
    if (values < 1).any() or (values % 1 != 0).any() or values.prod() > limit:
        raise part.wrong(key, f"{values.tolist()}", f"three whole numbers with a product of at most {limit}")
    x, y, z = (int(v) for v in values)
    return x, y, z
