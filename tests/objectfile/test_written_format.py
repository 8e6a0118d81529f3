"""A reader written from docs/objectfile.md alone, with nothing but numpy, finds what ObjectFile finds."""

import json
import lzma

import numpy as np
import pytest
import torch

from objectfolder.vision.osf_net import OsfNet


@pytest.fixture(scope="module")
def stored(brick_path):
    """Header and tensors, read by hand."""
    raw = brick_path.read_bytes()
    length = int.from_bytes(raw[:8], "little")
    outer, body = json.loads(raw[8 : 8 + length]), raw[8 + length :]
    header = json.loads(outer.pop("__metadata__")["objectfolder"])
    dtypes = {"U8": np.uint8, "I8": np.int8, "F16": np.float16, "F32": np.float32, "F64": np.float64}
    tensors = {}
    for name, entry in outer.items():
        values = np.frombuffer(body[slice(*entry["data_offsets"])], dtypes[entry["dtype"]])
        tensors[name] = values.reshape(entry["shape"])
    return header, tensors


def grid_of(header, tensors):
    geometry = header["geometry"]
    side = geometry["resolution"]
    values = np.frombuffer(lzma.decompress(tensors["geometry.distances"].tobytes()), np.int8)
    assert geometry["predictor"] == "none"
    return values.reshape(side, side, side) * (geometry["band"] / 127)


def trilinear(grid, points):
    side = len(grid)
    place = (points + 0.52) / (1.04 / (side - 1))
    cell = np.floor(place).astype(int)
    total = np.zeros(len(points))
    for corner in np.ndindex(2, 2, 2):
        weight = np.where(corner, place - cell, 1 - place + cell).prod(1)
        total += weight * grid[tuple((cell + corner).T)]
    return total


def test_the_distance_grid(stored, brick, rng):
    points = rng.uniform(-0.5, 0.5, (500, 3))
    found = trilinear(grid_of(*stored), points)
    ours = brick.surface.grid.distance(brick.surface.grid._volume.new_tensor(points)).numpy()
    np.testing.assert_allclose(found, ours, atol=1e-6)
    assert np.abs(trilinear(grid_of(*stored), brick.sample_surface(300) / brick.scale)).max() < 2e-3


def matrix(tensors, name):
    """Codes times powers of two, one for each row."""
    return tensors[name] * 2.0 ** tensors[f"{name}_exponent"][:, None].astype(float)


def test_the_mode_shapes(stored, brick):
    header, tensors = stored
    net, audio = header["audio"]["net"], {n[6:]: t for n, t in tensors.items() if n.startswith("audio.")}
    points = brick.sample_surface(20) / brick.scale
    side, resolution = net["resolution"] + 2, net["resolution"]
    used = np.unpackbits(audio["grid.used"], count=side**3).astype(bool)
    features = np.zeros((side**3, net["channels"]))
    features[used] = matrix(audio, "grid.table")
    nodes = (np.indices((side, side, side)).reshape(3, -1).T - 0.5) / resolution - 0.5
    away = np.abs(points[:, None] - nodes) * resolution
    spline = np.where(away < 0.5, 0.75 - away**2, np.where(away < 1.5, (1.5 - away) ** 2 / 2, 0)).prod(2)
    x = np.concatenate([2 * points, spline @ features], 1)
    w = net["frequency"]
    x = np.sin(w * (x @ audio["sines.layers.0.weight"].T + audio["sines.layers.0.bias"]))
    x = np.sin(w * (x @ matrix(audio, "sines.layers.1.weight").T + audio["sines.layers.1.bias"]))
    x = x @ matrix(audio, "output.weight").T + audio["output.bias"]
    shapes = x.reshape(len(points), 3, -1) * audio["amplitude"]
    ours = brick.mode_shapes(points * brick.scale)
    np.testing.assert_allclose(shapes, ours, atol=2e-3 * np.abs(ours).max())


def test_the_base_colours(stored, brick):
    """The look of vertices, from two hash grids and an MLP."""
    header, tensors = stored
    net, vision = header["vision"]["net"], {n[7:]: t for n, t in tensors.items() if n.startswith("vision.")}
    surface = brick.surface
    points = surface.vertices[::37].astype(np.float32)
    table = np.frombuffer(lzma.decompress(vision["grid.table"].tobytes()), np.int8)
    table = table.reshape(-1, net["features"])
    growth = (net["finest"] / net["coarsest"]) ** (1 / (net["levels"] - 1))
    found, start = [], 0
    for level in range(net["levels"]):
        cells = int(np.floor(net["coarsest"] * growth**level + 1e-9))
        dense = (cells + 1) ** 3 <= 2 ** net["table_bits"]
        size = (cells + 1) ** 3 if dense else 2 ** net["table_bits"]
        rows = table[start : start + size] * vision["grid.factors"][level]
        start += size
        place = (points / 0.52 + 1) / 2 * cells
        cell = np.minimum(np.floor(place), cells - 1).astype(np.int64)
        total = 0
        for corner in np.ndindex(2, 2, 2):
            weight = np.where(corner, place - cell, 1 - place + cell).prod(1)
            x, y, z = (cell + corner).T
            entry = x + (cells + 1) * (y + (cells + 1) * z)
            if not dense:
                entry = (x ^ (y * 2654435761) ^ (z * 805459861)) & (2 ** net["table_bits"] - 1)
            total = total + weight[:, None] * rows[entry]
        found.append(total)
    assert start == len(table)
    x = np.concatenate([*found, points], 1)
    x = np.maximum(x @ vision["appearance.0.weight"].T.astype(float) + vision["appearance.0.bias"], 0)
    x = x @ vision["appearance.2.weight"].T.astype(float) + vision["appearance.2.bias"]
    srgb = (x[:, :3] + 0.5).clip(0, 1)
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    baked = brick._parts.vision.net.bake(surface).look[::37].numpy()
    np.testing.assert_allclose(linear, baked[:, :3], atol=1e-4)


def hidden_layers(tensors, x):
    """The paper's ReLU layers, of tensors named hidden.*."""
    hidden = x
    for i in range(sum(name.startswith("hidden.") for name in tensors) // 2):
        hidden = np.concatenate([x, hidden], 1) if i == 5 else hidden
        hidden = np.maximum(layer(tensors, f"hidden.{i}", hidden), 0)
    return hidden


def layer(tensors, name, x):
    return x @ tensors[f"{name}.weight"].T.astype(np.float32) + tensors[f"{name}.bias"]


def angles(x, octaves, lowest):
    return (x[:, :, None] * lowest * 2.0 ** np.arange(octaves)).reshape(len(x), -1)


def with_waves(x, angle):
    return np.concatenate([x, np.sin(angle), np.cos(angle)], 1)


def under(tensors, prefix):
    return {name.removeprefix(prefix): t for name, t in tensors.items() if name.startswith(prefix)}


def test_the_papers_network_of_spectrograms(spectrograms, rng):
    point, config = rng.uniform(-0.5, 0.5, (1, 3)), spectrograms.header["audio"]["net"]
    axes = np.meshgrid(np.linspace(-1, 1, 257), np.linspace(-1, 1, 201), indexing="ij")
    bins = np.stack(axes, -1).reshape(-1, 2)
    x = np.concatenate([np.tile(2 * point, (len(bins), 1)), bins], 1)
    both = [angles(x[:, :3], config["point_octaves"], np.pi), angles(x[:, 3:], config["bin_octaves"], np.pi)]
    found = []
    for axis, (low, high) in enumerate(spectrograms.tensors["audio.range"]):
        net = under(spectrograms.tensors, f"audio.branches.{axis}.")
        output = layer(net, "output", hidden_layers(net, with_waves(x, np.concatenate(both, 1))))
        parts = output * (high - low) + low
        found.append((parts[:, 0] + 1j * parts[:, 1]).reshape(257, 201))
    ours = spectrograms._parts.audio.net.spectrograms(torch.from_numpy(point))[0].numpy()
    np.testing.assert_allclose(found, ours, atol=1e-4 * np.abs(ours).max())


def test_the_papers_network_of_views(rng):
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        octaves = {"point_octaves": 3, "direction_octaves": 2}
        net = OsfNet(4, 8, width=16, depth=7, branch_width=8, branch_depth=2, **octaves)
    tensors, config = net.to_tensors()
    net = OsfNet.from_tensors(tensors, config)
    point = rng.uniform(-0.5, 0.5, (50, 3))
    camera, light = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in rng.standard_normal((2, 50, 3)))
    fine = under(tensors, "fine.")
    hidden = hidden_layers(under(fine, "trunk."), with_waves(point, angles(point, 3, 1)))
    directions = [with_waves(d, angles(d, 2, 1)) for d in (camera, light)]
    x = np.concatenate([layer(fine, "bottleneck", hidden), *directions], 1)
    fraction = layer(fine, "fraction", hidden_layers(under(fine, "branch."), x))
    with torch.no_grad():
        density, features = net.fine(torch.from_numpy(point).float())
        scattered = net.fine.scattered(features, *(torch.from_numpy(d).float() for d in (light, camera)))
    np.testing.assert_allclose(np.maximum(layer(fine, "density", hidden)[:, 0], 0), density, atol=1e-5)
    np.testing.assert_allclose(1.2 / (1 + np.exp(-fraction)) - 0.1, scattered, atol=1e-5)
