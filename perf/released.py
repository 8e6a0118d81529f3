"""Query times of imported files of the released sizes: `python perf/released.py [--json FILE]`.

The weights are random. They do not affect the time, except that KiloOSF's depends on the occupied part of
its grid, here a ball of diameter 1.
"""

import argparse
import time
from pathlib import Path

import numpy as np
import torch
from harness import parsed, write_record

from objectfolder.nets.released_network import Frame, ReleasedNetwork
from objectfolder.sound.released_gains import ReleasedGains
from objectfolder.sound.released_spectrogram import ReleasedSpectrogram
from objectfolder.touch.profiles import load_profile
from objectfolder.touch.released_images import APEX, DEPTH_SIZE, ReleasedDepth, ReleasedImage
from objectfolder.vision.cameras import Intrinsics, look_at
from objectfolder.vision.osf_net import ScatteringFunction
from objectfolder.vision.released_kilo import ReleasedKilo
from objectfolder.vision.released_nerf import March, ReleasedNerf

WIDTH, DEPTH = 256, 8
MODES = 100
PIXELS = 32  # side of the timed views; a view of 256 has 64 times as many pixels
FRAME = Frame().to_dict()
BOUNDS = [[-0.5] * 3, [0.5] * 3]


def network(inputs, outputs):
    return ReleasedNetwork(inputs, WIDTH, DEPTH, 10, outputs).eval()


def nerf(crop):
    shape = {"width": WIDTH, "depth": DEPTH, "branch_width": WIDTH // 2, "branch_depth": 1}
    nets = {
        name: ScatteringFunction(**shape, point_octaves=10, direction_octaves=4)
        for name in ("coarse", "fine")
    }
    return ReleasedNerf(nets, March(0.01, 4.0, 64, 128, False), crop)


def kilo(grid=16, voxels=256, width=64):
    axis = (np.arange(voxels) + 0.5) / voxels * 1.2 - 0.6
    ball = (np.add.outer(np.add.outer(axis**2, axis**2), axis**2) < 0.25).ravel()
    sizes = {
        "points.0": (63, width),
        "points.1": (width, width),
        "density": (width, 1),
        "feature": (width, width),
        "direction": (width + 54, width),
        "color": (width, 3),
    }
    weights = {}
    for name, size in sizes.items():
        weights[f"{name}.weight"] = torch.randn(grid**3, *size) / size[0] ** 0.5
        weights[f"{name}.bias"] = torch.zeros(grid**3, size[1])
    box = [[-0.6] * 3, [0.6] * 3]
    march = March(0.01, 4.0, 384, 0, False)
    cells, mask = torch.arange(grid**3), torch.from_numpy(ball)
    return ReleasedKilo(weights, cells, mask, march, (grid,) * 3, (voxels,) * 3, box, (10, 4, 4))


def milliseconds(ask, repeats=3):
    """Return the minimum CPU time."""
    ask()
    times = []
    for _ in range(repeats):
        start = time.process_time()
        ask()
        times.append(time.process_time() - start)
    return 1e3 * min(times)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, help="file for the figures")
    arguments = parsed(parser)
    torch.set_num_threads(1)
    torch.manual_seed(0)
    pose, light = look_at(np.array([1.5, -1.6, 1.2]))[0], np.array([0, 0.6, 0.8])
    small = Intrinsics.square(PIXELS)
    full, cropped, grid = nerf(None), nerf(0.6), kilo()
    point = torch.tensor([[0.1, 0.2, 0.3]])
    one, none = np.array([0.001]), np.zeros(1)
    low, high = torch.zeros(3, MODES), torch.ones(3, MODES)
    modes = torch.linspace(200, 9000, MODES), torch.full((MODES,), 20.0)
    gains = ReleasedGains(
        [network(3, MODES) for _ in range(3)], {"frame": FRAME, "bounds": BOUNDS}, *modes, low, high
    )
    config = {"translation": [0.5] * 3, "scale": 1.0, "coordinates": [0, 32], "values": [[0, 1]] * 3}
    vertices = np.stack(np.meshgrid(*[np.arange(33)] * 3), -1).reshape(-1, 3)
    spectrogram = ReleasedSpectrogram([network(5, 2) for _ in range(3)], vertices, {"frame": FRAME, **config})
    image = {"frame": FRAME, "coordinates": [-0.5, 0.5], "press_depth": 0.001, "angle": 0.0}
    image_net = ReleasedImage(network(5, 3), image)
    sensor = {"frame": FRAME, "bounds": BOUNDS, "sensor": load_profile("gelsight_r15").to_dict()}
    depth_net = ReleasedDepth(network(9, 1), torch.full(DEPTH_SIZE, APEX), sensor)
    where = point.numpy()
    whole = (256 / PIXELS) ** 2
    rows = {
        "view 256x256, NeRF (1.0), extrapolated": whole
        * milliseconds(lambda: full.picture(pose, light, small), 1),
        "same, --crop 0.6": whole * milliseconds(lambda: cropped.picture(pose, light, small), 1),
        "view 256x256, KiloOSF (2.0)": milliseconds(
            lambda: grid.picture(pose, light, Intrinsics.square(256)), 1
        ),
        "spectrograms of a strike (1.0)": milliseconds(lambda: spectrogram.spectrograms(point), 1),
        f"gains of a strike, {MODES} modes (2.0)": milliseconds(lambda: gains.shapes(point), 20),
        "the same of 1,024 strikes, each": milliseconds(lambda: gains.shapes(point.expand(1024, 3))) / 1024,
        "tactile image (1.0)": milliseconds(lambda: image_net.images(where)),
        "depth map (2.0)": milliseconds(lambda: depth_net.depth_maps(where, one, none, none)),
        "depth map and image (2.0)": milliseconds(lambda: list(depth_net.touches(where, one, none, none))),
    }
    for name, value in rows.items():
        print(f"{name:45}{value:12,.1f} ms")
    write_record(arguments.json, {"queries": rows})


if __name__ == "__main__":
    main()
