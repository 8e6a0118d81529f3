"""Readers of the nets of released files.

All raise ObjectFolderError if an entry is missing or not as documented.
"""

import math
from typing import Any

import numpy as np
import torch
from torch.nn.functional import interpolate

from objectfolder.hub.importer.checkpoint import ReleasedDict
from objectfolder.nets.positional import SKIP
from objectfolder.nets.released_network import Frame, ReleasedNetwork, build_network
from objectfolder.sound.released_gains import ReleasedGains
from objectfolder.sound.released_spectrogram import AXES, NEIGHBOURS, ReleasedSpectrogram
from objectfolder.touch.profiles import SensorProfile
from objectfolder.touch.released_images import APEX, DEPTH_SIZE, DEPTHS, PIXEL, ReleasedDepth, ReleasedImage
from objectfolder.vision.osf_net import ScatteringFunction
from objectfolder.vision.released_kilo import MARGIN, MAX_CELLS, ReleasedKilo
from objectfolder.vision.released_nerf import MAX_SAMPLES, March, ReleasedNerf, build_scattering

DEPTH = 8  #: default number of hidden layers
MAX_MODES = 1 << 16
#: Ray marching settings, fixed in the released code of 1.0.
MARCH = March(near=0.01, far=4.0, samples=64, more=128, inverse=False)
# Settings that make the released code render in a way that is not supported here.
_UNSUPPORTED = (
    *("no_color_sigmoid", "use_view_independent_color", "use_hard_parameter_sharing_for_color"),
    *("use_global_coordinates", "use_single_net", "crop_to_global_domain", "visualize_global_domain"),
    "render_debug_network_color_map",
)
PRESS_DEPTH = 0.001  #: m, assigned to images of 1.0, whose true depth is unknown; the default of queries
_PROBES = 64  # contacts to estimate the untouched gel from
_STRIDE = 4  # pixel stride of the estimate
_QUANTILE = 0.9  # quantile of the probes' depths


def by_octave(inputs: int, octaves: int) -> np.ndarray:
    """Return the channels of the released encoding in our order, that of `nets.positional.append_octaves`.

    Released: all numbers, then for each octave all sines and all cosines. Ours: all numbers, then all sines,
    then all cosines, each ordered by number.
    """
    number, octave = np.mgrid[:inputs, :octaves].reshape(2, -1)
    sine = inputs * (1 + 2 * octave) + number
    return np.concatenate([np.arange(inputs), sine, sine + inputs])


def by_number(inputs: int, octaves: int) -> np.ndarray:
    """Return the same for KiloOSF, which stores each number, its cosines and then its sines."""
    number, octave = np.mgrid[:inputs, :octaves].reshape(2, -1)
    size = 1 + 2 * octaves
    cosine = number * size + 1 + octave
    return np.concatenate([np.arange(inputs) * size, cosine + octaves, cosine])


def octaves_of(state: ReleasedDict, key: str, channels: int, inputs: int) -> int:
    """Return the octaves of an encoding with ``channels`` channels of ``inputs`` numbers."""
    octaves, rest = divmod(channels // inputs - 1, 2)
    if channels % inputs or rest or octaves < 0:
        expected = f"{inputs} times an odd number: an encoding of {inputs} numbers"
        raise state.wrong(key, f"for {channels} channels", expected)
    return octaves


def _layer(state: ReleasedDict, theirs: str, ours: str, *shape: int) -> dict[str, torch.Tensor]:
    """Read weight and bias of a linear layer."""
    weight, bias = state.tensor(f"{theirs}.weight", *shape), state.tensor(f"{theirs}.bias", shape[0])
    return {f"{ours}.weight": weight, f"{ours}.bias": bias}


def trunk(
    state: ReleasedDict, inputs: int, prefix: str, refeed: bool = True, depth: int = DEPTH
) -> tuple[dict[str, torch.Tensor], int]:
    """Read the layers ``pts_linears.N`` as those of a `SkipNetwork`.

    ``inputs``: numbers before encoding; ``prefix``: prefix of the returned names; ``refeed``: whether the
    input is concatenated again after the layer of index 4; ``depth``: number of layers.
    """
    width, channels = state.tensor("pts_linears.0.weight", None, None).shape
    octaves = octaves_of(state, "pts_linears.0.weight", channels, inputs)
    order = by_octave(inputs, octaves)
    tensors: dict[str, torch.Tensor] = {}
    for i in range(depth):
        joined = channels if i == SKIP + 1 and refeed else 0
        name = f"{prefix}hidden.{i}"
        tensors |= _layer(state, f"pts_linears.{i}", name, width, width + joined if i else channels)
        weight = tensors[f"{name}.weight"]
        if i == 0 or joined:
            tensors[f"{name}.weight"] = torch.cat([weight[:, :channels][:, order], weight[:, channels:]], 1)
        elif i == SKIP + 1:  # ours always concatenates the input: weights of zero ignore it
            tensors[f"{name}.weight"] = torch.cat([weight.new_zeros(width, channels), weight], 1)
    return tensors, octaves


def network(state: ReleasedDict, inputs: int, outputs: int) -> dict[str, torch.Tensor]:
    """Read ``pts_linears`` and ``output_linear`` as a `ReleasedNetwork`; the view layer is unused."""
    tensors, _ = trunk(state, inputs, "")
    return tensors | _layer(state, "output_linear", "output", outputs, len(tensors["hidden.0.weight"]))


def spectrogram_net(audio: ReleasedDict, frame: Frame) -> ReleasedSpectrogram:
    """Read an AudioNet of ObjectFolder 1.0."""
    vertices = audio.numbers("voxel_vertex", None, 3)
    if len(vertices) < NEIGHBOURS or np.ptp(vertices) == 0:
        raise audio.wrong("voxel_vertex", f"{len(vertices)} vertices", f"{NEIGHBOURS} or more, not all equal")
    normalizer = audio.part("normalizer")
    values = [[normalizer.number(f"f{axis}_{end}") for end in ("min", "max")] for axis in (1, 2, 3)]
    state = audio.state("model_state_dict")
    branches = [build_network(network(state.below(f"model_{axis}."), 5, 2), 5) for axis in AXES]
    config = {
        "frame": frame.to_dict(),
        "translation": audio.numbers("translation", 3).tolist(),
        "scale": audio.number("scale"),
        "coordinates": [float(vertices.min()), float(vertices.max())],
        "values": values,
    }
    return ReleasedSpectrogram(branches, vertices, config)


def gains_net(audio: ReleasedDict, frame: Frame) -> ReleasedGains:
    """Read an AudioNet of ObjectFolder 2.0."""
    frequencies = audio.numbers("frequencies", None)
    count = len(frequencies)
    dampings = audio.numbers("dampings", count)
    if not 0 < count <= MAX_MODES or frequencies.min() < 0:
        raise audio.wrong("frequencies", f"{count} numbers, not all positive", "frequencies in Hz")
    normalizer = audio.part("normalizer")
    low, high = (
        torch.from_numpy(np.stack([normalizer.numbers_or_one(f"f{i}_{end}", count) for i in (1, 2, 3)]))
        for end in ("min", "max")
    )
    state = audio.state("model_state_dict")
    heard = torch.from_numpy(frequencies > 0)  # sin(2 pi 0 t) is silent
    branches = []
    for axis in AXES:
        tensors = network(state.below(f"model_{axis}."), 3, count)
        tensors |= {name: tensors[name][heard] for name in ("output.weight", "output.bias")}
        branches.append(build_network(tensors, 3))
    config = {"frame": frame.to_dict(), "bounds": box(normalizer)}
    modes = (torch.from_numpy(frequencies), torch.from_numpy(dampings), low, high)
    return ReleasedGains(branches, config, *(x.float()[..., heard] for x in modes))


def box(part: ReleasedDict) -> list[list[float]]:
    """Return the bounds ``xyz_min`` and ``xyz_max``, each stored as three numbers or as one for all axes."""
    low, high = (part.numbers_or_one(f"xyz_{end}", 3) for end in ("min", "max"))
    if not (low < high).all():
        raise part.wrong("xyz_min", f"{low.tolist()}", f"numbers below xyz_max, {high.tolist()}")
    return [low.tolist(), high.tolist()]


def nerf_net(vision: ReleasedDict, crop: float | None = None) -> ReleasedNerf:
    """Read a VisionNet of ObjectFolder 1.0."""
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
    for name in _UNSUPPORTED:
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
    bottleneck = _first(state, "bottleneck_linear", "feature_linear")
    views = _first(state, "views_lights_linears.0", "views_linears.0")
    joint = state.tensor(f"{views}.weight", None, None)
    branch, channels = len(joint), joint.shape[1] - width
    direction_octaves = octaves_of(state, f"{views}.weight", max(channels, 0), 6)
    order = by_octave(3, direction_octaves)
    order = np.concatenate([np.arange(width), width + order, width + len(order) + order])
    tensors["branch.hidden.0.weight"] = joint[:, order]
    tensors["branch.hidden.0.bias"] = state.tensor(f"{views}.bias", branch)
    tensors |= _layer(state, "alpha_linear", "density", 1, width)
    tensors |= _layer(state, bottleneck, "bottleneck", width, width)
    tensors |= _layer(state, "rgb_linear", "fraction", 3, branch)
    return build_scattering(tensors, octaves, direction_octaves)


def _first(state: ReleasedDict, *names: str) -> str:
    """Return the first of the names that a layer has; of none, the first."""
    return next((name for name in names if f"{name}.weight" in state), names[0])


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
    cells = _select_cells(occupied, voxels, grid)
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
    ways = [by_number(3, octaves[1]), view + by_number(3, octaves[2])]
    orders = {
        "points.0": by_number(3, octaves[0]),
        "direction": np.concatenate([np.arange(width), *(width + way for way in ways)]),
    }
    weights: dict[str, Any] = {}
    for ours, (theirs, inputs, outputs) in names.items():
        weight = state.tensor(f"{theirs}.weight", count, inputs, outputs)[cells]
        weights[f"{ours}.weight"] = weight[:, orders[ours]] if ours in orders else weight
        weights[f"{ours}.bias"] = state.tensor(f"{theirs}.bias", count, outputs)[cells]
    box = [corner.tolist() for corner in corners]
    return ReleasedKilo(weights, cells, occupied, march, grid, voxels, box, octaves)


def _select_cells(occupied: torch.Tensor, voxels: tuple[int, ...], grid: tuple[int, ...]) -> torch.Tensor:
    """Return the cells that overlap an occupied voxel; the networks of the others are never evaluated."""
    # A cell covers the voxels from one end to the other; one more on each side allows for rounding.
    mask = occupied.view(voxels)
    for axis, (fine, coarse) in enumerate(zip(voxels, grid)):
        starts = [max(math.floor(i * fine / coarse) - 1, 0) for i in range(coarse)]
        ends = [min(math.ceil((i + 1) * fine / coarse) + 1, fine) for i in range(coarse)]
        parts = [mask.narrow(axis, start, end - start) for start, end in zip(starts, ends)]
        mask = torch.stack([part.any(axis) for part in parts], axis)
    return mask.flatten().nonzero()[:, 0]


def _sizes(part: ReleasedDict, key: str, limit: int) -> tuple[int, int, int]:
    values = part.numbers(key, 3)
    if (values < 1).any() or (values % 1 != 0).any() or values.prod() > limit:
        raise part.wrong(key, f"{values.tolist()}", f"three whole numbers with a product of at most {limit}")
    x, y, z = (int(v) for v in values)
    return x, y, z


def image_net(touch: ReleasedDict, frame: Frame, bounds: np.ndarray) -> ReleasedImage:
    """Read a TouchNet of ObjectFolder 1.0; ``bounds`` (2, 3): of the object in the file's coordinates."""
    net = build_network(network(touch.state("model_state_dict"), 5, 3), 5)
    coordinates = [float(bounds.min()), float(bounds.max())]
    config: dict[str, Any] = {"frame": frame.to_dict(), "coordinates": coordinates}
    config |= {"press_depth": PRESS_DEPTH, "angle": 0.0, "sensor": "tacto_digit"}
    return ReleasedImage(net, config)


def depth_net(
    touch: ReleasedDict, frame: Frame, profile: SensorProfile, gel: np.ndarray | None = None
) -> ReleasedDepth:
    """Read a TouchNet of ObjectFolder 2.0.

    ``profile``: sensor that renders images from the depth maps. ``gel`` (120, 160): the untouched gel as the
    released code stores it (``calibs/depth_bg.npy``): heights in pixels. Default: the 90th percentile of the
    depths of contacts across the object, pixel by pixel.
    """
    net = build_network(network(touch.state("model_state_dict"), 9, 1), 9)
    config = {"frame": frame.to_dict(), "bounds": box(touch), "sensor": profile.to_dict()}
    if gel is None:
        return ReleasedDepth(net, _estimate_gel(net).float(), config)
    depth = APEX - PIXEL * np.asarray(gel, np.float64)
    return ReleasedDepth(net, torch.from_numpy(depth).float(), config)


@torch.no_grad()
def _estimate_gel(net: ReleasedNetwork) -> torch.Tensor:
    """Estimate the depth map of the untouched gel from the lightest contacts at random places; (120, 160)."""
    rng = np.random.default_rng(0)
    places = torch.from_numpy(rng.random((_PROBES, 3)).astype(np.float32))
    rows, columns = (torch.linspace(0, 1, n // _STRIDE) for n in DEPTH_SIZE)
    pixels = torch.stack(torch.meshgrid(rows, columns, indexing="ij"), -1).flatten(0, 1)
    upright = torch.tensor([0.0, 1.0, 0.0, 0.0])  # no tilt, azimuth 0, the lightest press
    contacts = [torch.cat([place, upright]).expand(len(pixels), -1) for place in places]
    depths = torch.stack([net(torch.cat([contact, pixels], 1))[:, 0] for contact in contacts])
    low = depths.quantile(_QUANTILE, 0).view(1, 1, len(rows), len(columns))
    full = interpolate(low, DEPTH_SIZE, mode="bilinear", align_corners=True)[0, 0]
    return full * (DEPTHS[1] - DEPTHS[0]) + DEPTHS[0]
