"""Gaussian splats beside the object's own views: `python perf/splats.py FILE ... [--json FILE]`.

Splats of `objectfolder export splats` are drawn as viewers draw them and compared with `ObjectFile.view`,
under the lights of the studio; beside as many round ones at random places. Exits with 1 if a target is
missed.
"""

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from harness import beyond, exit_with_verdict, parsed, print_rows, write_record
from rich.console import Console
from scipy.spatial import cKDTree

from objectfolder.objectfile.file import ObjectFile
from objectfolder.objectfile.splats import COUNT, DEGREE, Splats, harmonics, splats
from objectfolder.vision.cameras import CAMERA_RADIUS, Intrinsics, look_at, sphere_points

CAMERAS, SIDE, TARGET = 24, 256, 30.0
BLUR = 0.3  # px^2 that the authors' rasteriser, and viewers, add to each splat's image
REACH = 3.33  # standard deviations that are drawn: where opacity falls to 1/255


def rasterise(cloud: Splats, pose: np.ndarray, seen_by: Intrinsics) -> np.ndarray:
    """Draw splats on white, as viewers do: sorted by depth, sRGB; (H, W, 3)."""
    turn, place = pose[:3, :3] * [1, -1, -1], pose[:3, 3]
    local = (cloud.points - place) @ turn
    x, y, z = local.T
    spot = np.stack([seen_by.fx * x / z + seen_by.cx, seen_by.fy * y / z + seen_by.cy], 1)
    jacobian = np.zeros((len(cloud), 2, 3))
    jacobian[:, 0, 0], jacobian[:, 0, 2] = seen_by.fx / z, -seen_by.fx * x / z**2
    jacobian[:, 1, 1], jacobian[:, 1, 2] = seen_by.fy / z, -seen_by.fy * y / z**2
    axes = rotations(cloud.turns) * cloud.scales[:, None]
    root = jacobian @ (turn.T @ axes)
    spread = root @ root.transpose(0, 2, 1) + BLUR * np.eye(2)
    inverse = np.linalg.inv(spread)
    way = cloud.points - place
    degree = round(cloud.colors.shape[1] ** 0.5) - 1
    basis = harmonics(way / np.linalg.norm(way, axis=1, keepdims=True), degree)
    color = (np.einsum("nk,nkc->nc", basis, cloud.colors) + 0.5).clip(0)
    radius = np.ceil(REACH * np.sqrt(np.linalg.eigvalsh(spread)[:, -1])).astype(int)
    order = np.argsort(z, kind="stable")
    # Pairs of splats and pixels that they reach, nearest splats first.
    pairs_of, pixels_of, alphas = [], [], []
    for reach in np.unique(radius):
        rows = order[radius[order] == reach]
        offsets = np.stack(np.meshgrid(*[np.arange(-reach, reach + 1)] * 2), -1).reshape(-1, 2)
        for part in np.array_split(rows, max(1, len(rows) * len(offsets) // 4_000_000)):
            pixel = np.floor(spot[part]).astype(int)[:, None] + offsets
            x, y = np.moveaxis((pixel + 0.5 - spot[part][:, None]).astype(np.float32), 2, 0)
            (xx, xy), (_, yy) = np.moveaxis(inverse[part], 0, 2)[..., None].astype(np.float32)
            power = -0.5 * (xx * x * x + yy * y * y) - xy * x * y
            alpha = np.minimum(cloud.opacity[part][:, None] * np.exp(power), 0.99)
            inside = ((pixel >= 0) & (pixel < [seen_by.width, seen_by.height])).all(2) & (alpha >= 1 / 255)
            which, _ = np.nonzero(inside)
            pairs_of.append(part[which])
            pixels_of.append(pixel[inside] @ [1, seen_by.width])
            alphas.append(alpha[inside])
    pair, pixel, alpha = (np.concatenate(parts) for parts in (pairs_of, pixels_of, alphas))
    rank = np.empty(len(cloud), int)
    rank[order] = np.arange(len(cloud))
    sorting = np.argsort(pixel * len(cloud) + rank[pair])
    pair, pixel, alpha = pair[sorting], pixel[sorting], alpha[sorting]
    passed = np.concatenate([[0], np.cumsum(np.log1p(-alpha))])
    starts = np.flatnonzero(np.r_[True, pixel[1:] != pixel[:-1]])
    lengths = np.diff(np.r_[starts, len(pixel)])
    before = np.exp(passed[:-1] - np.repeat(passed[starts], lengths))
    image = np.ones((seen_by.height * seen_by.width, 3))
    image[pixel[starts]] = np.add.reduceat((before * alpha)[:, None] * color[pair], starts, 0)
    image[pixel[starts]] += np.exp(passed[starts + lengths] - passed[starts])[:, None]
    return image.reshape(seen_by.height, seen_by.width, 3).clip(0, 1)


def rotations(turns: np.ndarray) -> np.ndarray:
    """Matrices (N, 3, 3) of quaternions w, x, y, z (N, 4)."""
    w, x, y, z = turns.T
    rows = [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)]
    rows += [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)]
    rows += [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]
    return np.stack(rows, 1).reshape(-1, 3, 3)


def plain(file: ObjectFile, cloud: Splats) -> Splats:
    """As many round Gaussians drawn at random on the surface, with the colour of the nearest splat."""
    points = file.sample_surface(len(cloud))
    near = cKDTree(cloud.points).query(points)[1]
    size = np.full((len(points), 3), np.median(cloud.scales[:, 0]))
    return replace(cloud, points=points, scales=size, colors=cloud.colors[near, :1])


def scores(file: ObjectFile, clouds: dict[str, Splats], cameras: int = CAMERAS) -> dict[str, np.ndarray]:
    """PSNR of each cloud, dB, at so many random places against `ObjectFile.view`."""
    places = sphere_points(cameras, CAMERA_RADIUS, np.random.default_rng(0))
    seen_by, found = Intrinsics.square(SIDE), {name: [] for name in clouds}
    for pose in look_at(places):
        truth = file.view(pose[None], intrinsics=seen_by, lights="studio")[0]
        inside = pose.copy()
        inside[:3, 3] *= file.scale
        for name, cloud in clouds.items():
            error = np.square(rasterise(cloud, inside, seen_by) - truth).mean()
            found[name].append(-10 * np.log10(error))
    return {name: np.array(values) for name, values in found.items()}


def measure(path: Path, count: int) -> dict:
    file = ObjectFile.load(path)
    start = time.process_time()
    cloud = splats(file, count)
    seconds = time.process_time() - start
    clouds = {"psnr": cloud, "plain": plain(file, cloud)}
    found = scores(file, clouds)
    row = {
        "object": file.key,
        "splats": len(cloud),
        "megabytes": len(cloud.to_ply()) / 1e6,
        "seconds": seconds,
    }
    row |= {name: float(values.mean()) for name, values in found.items()}
    return row | {"worst": float(found["psnr"].min())}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("files", nargs="+", type=Path, metavar="FILE", help="Object Files")
    parser.add_argument("--count", type=int, default=COUNT, help="splats of each")
    parser.add_argument("--json", type=Path, help="file for the figures")
    arguments = parsed(parser)
    console, rows, missed = Console(width=max(Console().width, 110)), [], []
    for path in arguments.files:
        rows.append(measure(path, arguments.count))
        console.print(rows[-1])
        missed = beyond(rows, {"psnr": TARGET}, "dB", least=True)
        write_record(arguments.json, rows, f"{TARGET:g} dB on average over {CAMERAS} views", missed)
    form = {"object": ("object", ""), "splats": ("splats", ",d"), "megabytes": ("MB", ".1f")}
    form |= {"seconds": ("CPU s", ".0f"), "psnr": ("dB", ".1f"), "worst": ("worst dB", ".1f")}
    form |= {"plain": ("plain, dB", ".1f")}
    print_rows(rows, f"{CAMERAS} views of {SIDE} pixels, degree {DEGREE}", form, console)
    exit_with_verdict(missed, console)


if __name__ == "__main__":
    main()
