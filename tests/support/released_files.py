"""Files as ObjectFolder 1.0 and 2.0 released them, with random weights, and what they answer, in numpy.

The formulas are written out from their description, with loops, and share nothing with the package.
"""

import math
from collections import OrderedDict

import numpy as np
import torch


def linear(rng, inputs, outputs, gain=1.4):
    weight = rng.normal(0, gain / math.sqrt(inputs), (outputs, inputs))
    return weight.astype(np.float32), rng.normal(0, 0.1, outputs).astype(np.float32)


def put(state, name, layer):
    state[f"{name}.weight"], state[f"{name}.bias"] = map(torch.from_numpy, layer)


def smooth(weight, inputs, octaves):
    """Weaken what reads high octaves, as training does: else single precision tells other random pictures."""
    scale = np.repeat(2.0 ** -np.arange(octaves), 2 * inputs)
    weight[:, inputs : inputs * (1 + 2 * octaves)] *= scale.astype(np.float32)
    return weight


def mlp_state(rng, inputs, outputs, width=16, depth=8, octaves=10, prefix="", gain=1.0):
    """``pts_linears``, ``views_linears.0`` (unused) and ``output_linear``."""
    channels, state = inputs * (1 + 2 * octaves), OrderedDict()
    for i in range(depth):
        size = channels if i == 0 else width + channels * (i == 5)
        put(state, f"{prefix}pts_linears.{i}", linear(rng, size, width))
    put(state, f"{prefix}views_linears.0", linear(rng, width, width // 2))
    put(state, f"{prefix}output_linear", linear(rng, width, outputs, gain))
    return state


def nerf_state(rng, width=16, depth=8, octaves=(10, 4), prefix="", density=0.0, refeed=True):
    point, ways = 3 * (1 + 2 * octaves[0]), 6 * (1 + 2 * octaves[1])
    state = OrderedDict()
    for i in range(depth):
        size = point if i == 0 else width + point * (i == 5 and refeed)
        weight, bias = linear(rng, size, width)
        if size > width:
            weight = smooth(weight, 3, octaves[0])
        put(state, f"{prefix}pts_linears.{i}", (weight, bias))
    put(state, f"{prefix}bottleneck_linear", linear(rng, width, width))
    weight, bias = linear(rng, width, 1, 4.0)
    put(state, f"{prefix}alpha_linear", (weight, bias + np.float32(density)))
    put(state, f"{prefix}rgb_linear", linear(rng, width // 2, 3, 3.0))
    put(state, f"{prefix}views_lights_linears.0", linear(rng, ways + width, width // 2))
    return state


def encode(x, octaves):
    """Numbers, then for each octave the sines of all and the cosines of all; (N, D) -> (N, D (1 + 2 n))."""
    parts = [x]
    for k in range(octaves):
        parts += [np.sin(2.0**k * x), np.cos(2.0**k * x)]
    return np.concatenate(parts, 1)


def apply(state, name, x):
    weight, bias = (state[f"{name}.{part}"].numpy().astype(np.float64) for part in ("weight", "bias"))
    return x @ weight.T + bias


def trunk(state, x, prefix="", refeed=True):
    hidden, i = x, 0
    while f"{prefix}pts_linears.{i}.weight" in state:
        hidden = np.maximum(apply(state, f"{prefix}pts_linears.{i}", hidden), 0)
        if i == 4 and refeed:
            hidden = np.concatenate([x, hidden], 1)
        i += 1
    return hidden


def mlp(state, x, octaves=10, prefix=""):
    return apply(state, f"{prefix}output_linear", trunk(state, encode(x, octaves), prefix))


def sigmoid(x):
    return 1 / (1 + np.exp(-x))


def nerf(state, points, views, lights, octaves=(10, 4), prefix="", refeed=True):
    """Colour in about [0, 1] and raw density."""
    hidden = trunk(state, encode(points, octaves[0]), prefix, refeed)
    density = apply(state, f"{prefix}alpha_linear", hidden)[:, 0]
    joined = apply(state, f"{prefix}bottleneck_linear", hidden)
    x = np.concatenate([joined, encode(views, octaves[1]), encode(lights, octaves[1])], 1)
    x = np.maximum(apply(state, f"{prefix}views_lights_linears.0", x), 0)
    return 1.2 * (sigmoid(apply(state, f"{prefix}rgb_linear", x)) - 0.5) + 0.5, density


def kilo_encode(x, octaves):
    """Each number with the cosines, then the sines, of its octaves."""
    parts = []
    for column in x.T:
        angles = column[:, None] * 2.0 ** np.arange(octaves)
        parts += [column[:, None], np.cos(angles), np.sin(angles)]
    return np.concatenate(parts, 1)


def composed(color, density, distance, length):
    """Weights of samples and the colour on white of one ray; (S, 3), (S,), (S,)."""
    steps = np.append(np.diff(distance), 1e10) * length
    alpha = 1 - np.exp(-np.maximum(density, 0) * steps)
    through = np.cumprod(np.append(1.0, 1 - alpha + 1e-10))[:-1]
    weights = alpha * through
    return weights, weights @ color + 1 - weights.sum()


def refined(distance, weights, count):
    """Distances with those added that invert the cumulative sum of the inner weights."""
    middles = (distance[1:] + distance[:-1]) / 2
    share = weights[1:-1] + 1e-5
    cumulative = np.append(0, np.cumsum(share / share.sum()))
    more = []
    for u in np.linspace(0, 1, count):
        above = np.searchsorted(cumulative, u, side="right")
        below, above = max(above - 1, 0), min(above, len(cumulative) - 1)
        width = cumulative[above] - cumulative[below]
        width = 1 if width < 1e-5 else width
        t = (u - cumulative[below]) / width
        more.append(middles[below] + t * (middles[above] - middles[below]))
    return np.sort(np.append(distance, more))


def pose(camera):
    """The released formula of a camera on a sphere about the origin."""
    x, y, z = camera
    theta, phi = np.arccos(z / np.linalg.norm(camera)), np.arctan2(x, -y)
    rx = np.array([[1, 0, 0], [0, np.cos(theta), -np.sin(theta)], [0, np.sin(theta), np.cos(theta)]])
    rz = np.array([[np.cos(phi), -np.sin(phi), 0], [np.sin(phi), np.cos(phi), 0], [0, 0, 1]])
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = rz @ rx, camera
    return out


def rays(pose, size, focal):
    """Origin, and directions of the pixels' corners, whose component along the axis is one; (H, W, 3)."""
    ways = np.empty((size, size, 3))
    for row in range(size):
        for column in range(size):
            ways[row, column] = pose[:3, :3] @ [(column - size / 2) / focal, -(row - size / 2) / focal, -1]
    return pose[:3, 3], ways


def rendered(answer, pose, light, size, focal, near=0.01, far=4.0, samples=64, more=128):
    """Picture on white, alpha and mean distance; ``answer(which, points, views, lights)`` is the net."""
    origin, ways = rays(pose, size, focal)
    image, alphas, depths = np.empty((size, size, 3)), np.empty((size, size)), np.empty((size, size))
    t = np.linspace(0, 1, samples)
    first = near * (1 - t) + far * t

    def ask(which, distance, way):
        length = np.linalg.norm(way)
        points = origin + distance[:, None] * way
        views = np.tile(way / length, (len(points), 1))
        color, density = answer(which, points, views, np.tile(light, (len(points), 1)))
        return composed(color, density, distance, length)

    for place in np.ndindex(size, size):
        distance = first
        if more:
            weights, _ = ask("coarse", distance, ways[place])
            distance = refined(distance, weights, more)
        weights, image[place] = ask("fine", distance, ways[place])
        alphas[place], depths[place] = weights.sum(), weights @ distance
    return image, alphas, depths


def audio_branches(rng, inputs, outputs, width):
    state = OrderedDict()
    for axis in "xyz":
        state |= mlp_state(rng, inputs, outputs, width, prefix=f"module.model_{axis}.")
    return state


def ranges(rng, kind):
    ends = (("min", -1), ("max", 1))
    return {f"f{i}_{end}": kind(sign * rng.uniform(0.5, 2)) for i in (1, 2, 3) for end, sign in ends}


def released_1(seed=0, width=16, density=0.0):
    """A whole file of 1.0."""
    rng = np.random.default_rng(seed)
    vertices = np.unique(rng.integers(4, 29, (60, 3)), axis=0).astype(np.float64)
    audio_state = audio_branches(rng, 5, 2, width)
    optimizer = {"state": {0: {"step": 3, "exp_avg": torch.zeros(2)}}, "param_groups": []}
    return {
        "VisionNet": {
            **{"global_step": 200000, "optimizer_state_dict": optimizer},
            "network_fn_state_dict": nerf_state(rng, width, density=density),
            "network_fine_state_dict": nerf_state(rng, width, density=density),
        },
        "AudioNet": {
            "normalizer": ranges(rng, np.float32),
            **{"voxel_vertex": vertices, "translation": np.array([0.1, 0.12, 0.11])},
            **{"scale": np.float64(4.0), "model_state_dict": audio_state},
        },
        "TouchNet": {"model_state_dict": mlp_state(rng, 5, 3, width, prefix="module.")},
    }


def released_2(seed=0, width=16, modes=7):
    """A whole file of 2.0 without KiloOSF."""
    rng, bounds = np.random.default_rng(seed), {"xyz_min": np.float64(-0.08), "xyz_max": np.float64(0.11)}
    audio_state, normalizer = audio_branches(rng, 3, modes, width), ranges(rng, float)
    return {
        "VisionNet": {"cfg": config_2(width), "model_state_dict": nerf_state(rng, width)},
        "AudioNet": {
            "normalizer": normalizer | bounds,
            "frequencies": rng.uniform(200, 7000, modes),
            "dampings": rng.uniform(5, 60, modes),
            "model_state_dict": audio_state,
        },
        "TouchNet": bounds | {"model_state_dict": mlp_state(rng, 9, 1, width, prefix="module.", gain=0.5)},
    }


def config_2(width=16, **other):
    return {
        **{"num_hidden_layers": 8, "hidden_layer_size": width, "direction_layer_size": width // 2},
        **{"refeed_position_index": 4, "num_frequencies": 10, "num_frequencies_direction": 4},
        **{"near": 0.01, "far": 4, "num_samples_per_ray": 48, "num_importance_samples_per_ray": 0},
        **{"perturb": 1.0, "raw_noise_std": 0.0, "blender_white_background": True, "llff_lindisp": False},
        **{"no_color_sigmoid": False, "model_type": "single_network"},
        **other,
    }


def released_kilo(seed=0, width=8, grid=(3, 2, 4), voxels=(9, 8, 8), filled=0.5):
    """The VisionNet of a file with KiloOSF."""
    rng = np.random.default_rng(seed)
    count, point, ways = math.prod(grid), 3 * (1 + 2 * 4), 3 * (1 + 2 * 2)
    sizes = {
        "pts_linears.0": (point, width),
        "pts_linears.1": (width, width),
        "alpha_linear": (width, 1),
        "feature_linear": (width, width),
        "direction_layer": (width + 2 * ways, width),
        "rgb_linear": (width, 3),
    }
    state = {}
    for name, (inputs, outputs) in sizes.items():
        gain = 30 if name == "alpha_linear" else 1.4
        weight = rng.normal(0, gain / math.sqrt(inputs), (count, inputs, outputs))
        state[f"{name}.weight"] = torch.from_numpy(weight.astype(np.float32))
        state[f"{name}.bias"] = torch.from_numpy(rng.normal(0, 0.1, (count, outputs)).astype(np.float32))
    cfg = config_2(
        **{"width": width, "num_hidden_layers": 2, "direction_layer_size": width},
        **{"num_frequencies": 4, "num_frequencies_direction": 2, "num_frequencies_light": 2},
        **{"fixed_resolution": list(grid), "global_domain_min": [-0.6] * 3, "global_domain_max": [0.6] * 3},
        **{"late_feed_direction": True, "refeed_position_index": "None", "model_type": "multi_network"},
        occupancy={"resolution": list(voxels), "threshold": 10},
    )
    occupied = torch.from_numpy(rng.random(math.prod(voxels)) < filled)
    return {"VisionNet": {"cfg": cfg, "model_state_dict": state, "occupancy_grid": occupied}}


def kilo(vision, points, views, lights):
    """Colour and raw density at points, one at a time."""
    cfg, state = vision["cfg"], vision["model_state_dict"]
    low, high = np.array(cfg["global_domain_min"]), np.array(cfg["global_domain_max"])
    grid, voxels = np.array(cfg["fixed_resolution"]), np.array(cfg["occupancy"]["resolution"])
    occupied = vision["occupancy_grid"].reshape(tuple(voxels)).numpy()
    color, density = np.zeros((len(points), 3)), np.zeros(len(points))
    for i, (point, view, light) in enumerate(zip(points, views, lights)):
        if (point <= low + 0.001).any() or (point >= high - 0.001).any():
            continue
        if not occupied[tuple(((point - low) / ((high - low) / voxels)).astype(int))]:
            continue
        cell = ((point - low) / ((high - low) / grid)).astype(int)
        net = (cell[0] * grid[1] + cell[1]) * grid[2] + cell[2]
        start = low + cell * (high - low) / grid
        x = 2 * (point - start) / ((high - low) / grid) - 1

        def layer(name, x, net=net):
            weight, bias = (state[f"{name}.{part}"][net].double().numpy() for part in ("weight", "bias"))
            return x @ weight + bias

        x = kilo_encode(x[None], cfg["num_frequencies"])[0]
        x = np.maximum(layer("pts_linears.1", np.maximum(layer("pts_linears.0", x), 0)), 0)
        density[i] = layer("alpha_linear", x)[0]
        ways = [kilo_encode(view[None], 2)[0], kilo_encode(light[None], 2)[0]]
        x = np.maximum(layer("direction_layer", np.concatenate([layer("feature_linear", x), *ways])), 0)
        color[i] = 1.2 * (sigmoid(layer("rgb_linear", x)) - 0.5) + 0.5
    return color, density
