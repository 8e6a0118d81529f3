"""Inspections of the trained nets, the Object File and its metrics."""

import csv
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from objectfolder.base.arrays import read_safetensors
from objectfolder.base.figures import page, page_rows, save_page, show_image
from objectfolder.base.io import read_json
from objectfolder.objectfile.file import ObjectFile
from objectfolder.report.comparison import show_sound, shown_rate
from objectfolder.report.inspection import Inspection, in_kilobytes, kilobytes, picture_path, require, span
from objectfolder.vision.lighting import PointLight, studio
from objectfolder.workspace.layout import Build

#: Unit of the horizontal axis of a training curve, and the loss, by sense.
CURVES = {
    "vision": ("step", "squared error of sRGB"),
    "audio": ("step", "relative squared error of gains, or of spectrograms"),
    "touch": ("step, or round of the depth offset's search", "squared error of images in [0, 1]"),
}
CAMERAS = np.array([[0.8, -2.1, 1.1], [2.2, 0.9, 0.7], [-1.7, 1.5, 1.0], [0.3, -1.2, -2.1]])
FILL = PointLight((0.1, -0.6, -0.8))  # beside the studio, which leaves the underside dark
TOUCHES = 4
PRESS = 0.001  # m
#: Scores by parts of their names: unit, and what is better. Those in per cent are stored as shares.
SCORES = (
    ("psnr_standard_error", " dB", ""),
    ("psnr", " dB", ", higher is better"),
    ("ssim", "", ", higher is better"),
    ("noise_floor|baseline_(white|silence|noise|mean_image)", " dB", ""),
    ("_error|lost_energy", " %", ", lower is better"),
    ("baseline_nearest|obstructed_fraction", " %", ""),
    ("_hz", " Hz", ""),
    ("file_bytes", " bytes", ""),
)


def inspect_net(build: Build, modality: str) -> Inspection:
    """Inspect the training curve and the tensors of one net."""
    stage, net, curve = f"train_{modality}", build.net(modality), build.curve(modality)
    require(build, stage, net, curve)
    tensors, header = read_safetensors(net)
    table = [
        ("kind", str(header.get("kind"))),
        *((f"  {name}", value) for name, value in _leaves(header.get("net", {}))),
        *_tensor_rows(tensors),
        ("file", kilobytes(net)),
    ]
    with curve.open() as stream:
        points = [{name: float(value) for name, value in row.items()} for row in csv.DictReader(stream)]
    if not points:
        return Inspection(f"{stage}@{build.key}", [*table, ("curve", "empty: there was nothing to train")])
    best, last = min(points, key=lambda point: point["val_loss"]), points[-1]
    table += [
        ("loss", CURVES[modality][1]),
        ("steps", f"{last['step']:.0f}, {len(points)} evaluations"),
        ("last training loss", f"{last['train_loss']:.4g}"),
        ("best validation loss", f"{best['val_loss']:.4g} at step {best['step']:.0f}"),
    ]
    figure = page(8, 5, f"{stage}@{build.key}")
    axes = figure.subplots()
    steps = [point["step"] for point in points]
    for name, label in (("train_loss", "training"), ("val_loss", "validation")):
        axes.plot(steps, [point[name] for point in points], marker="o", markersize=4, label=label)
    ring: dict[str, Any] = {
        "s": 130,
        "facecolors": "none",
        "edgecolors": "black",
        "label": "lowest validation",
    }
    axes.scatter(best["step"], best["val_loss"], **ring)
    axes.set(xlabel=CURVES[modality][0], ylabel=CURVES[modality][1])
    losses = [point[name] for point in points for name in ("train_loss", "val_loss")]
    if 0 < 10 * min(losses) < max(losses):
        axes.set_yscale("log")
    else:
        axes.set_ylim(bottom=0)
    axes.locator_params(axis="x", integer=True)
    axes.grid(alpha=0.3, which="both")
    axes.legend()
    return Inspection(f"{stage}@{build.key}", table, [save_page(figure, picture_path(build, stage))])


def inspect_pack(build: Build) -> Inspection:
    """Inspect the header, tensors and sample answers of the Object File."""
    require(build, "pack", build.object_file)
    file = ObjectFile.load(build.object_file)
    header = {name: value for name, value in file.header.items() if name != "provenance"}
    # The sensor by name: `inspect train_touch` lists its profile.
    header["touch"] = {**header["touch"], "net": {**header["touch"]["net"], "sensor": file.sensor}}
    table = [
        *_leaves(header),
        *((f"made from {name}", digest[:12]) for name, digest in file.header.get("provenance", {}).items()),
        *_tensor_rows(file.tensors),
        ("modes", f"{len(file.frequencies)}, {span(file.frequencies, 'Hz', ',.0f')}"),
        ("file", kilobytes(build.object_file)),
    ]
    return Inspection(f"pack@{build.key}", table, [_pack_picture(build, file)])


def inspect_evaluate(build: Build) -> Inspection:
    """Inspect the metrics; pictures compare views and spectrograms with the ground truth."""
    sheets = [build.vision_sheet, build.sound_sheet]
    require(build, "evaluate", build.metrics, *sheets)
    rows = [(name, _score(name, value)) for name, value in _flat(read_json(build.metrics))]
    return Inspection(f"evaluate@{build.key}", rows, sheets)


def _pack_picture(build: Build, file: ObjectFile) -> Path:
    points = file.sample_surface(TOUCHES)
    title = f"pack@{build.key}: answers of the Object File ({file.material}, {file.scale * 1000:g} mm)"
    figure = page(14, 12, title)
    views, touches, sounds = page_rows(figure, 1.1, 1.1, 1)
    images = file.view(CAMERAS, lights=[*studio(), FILL])
    for axes, image, camera in zip(views.subplots(1, len(CAMERAS)), images, CAMERAS):
        show_image(axes, image, f"camera at {_triple(camera)} sizes")
    if (fixed := file.fixed_contact) is not None:
        depth, angle = fixed.depth, fixed.angle
    else:
        depth, angle = min(PRESS, file.sensor_profile.max_indentation), 0.0
    for axes, point, image in zip(touches.subplots(1, TOUCHES), points, file.touch(points, depth, angle)):
        show_image(axes, image, f"pressed {depth * 1000:g} mm at {_triple(point * 1000)} mm")
    rate = shown_rate(file)
    sound = file.impact(points[:1], np.array([[0.0, 0.0, 1.0]]), rate)[0]
    left, right = sounds.subplots(1, 2)
    left.plot(np.arange(len(sound)) / rate, sound * 1e6, linewidth=0.5)
    left.set(title=f"struck at {_triple(points[0] * 1000)} mm with 1 N s along z", xlabel="time [s]")
    left.set_ylabel("sum of modal displacements [$10^{-6}$ m kg$^{1/2}$]")
    left.grid(alpha=0.3)
    show_sound(right, sound, rate, "its spectrogram")
    return save_page(figure, picture_path(build, "pack"))


def _tensor_rows(tensors: Mapping[str, np.ndarray]) -> list[tuple[str, str]]:
    total, size = (sum(getattr(value, name) for value in tensors.values()) for name in ("nbytes", "size"))
    rows = [("tensors", f"{len(tensors)}: {size:,} numbers, {in_kilobytes(total)}")]
    for name, value in sorted(tensors.items()):
        shape = "x".join(map(str, value.shape)) or "scalar"
        rows.append((f"  {name}", f"{value.dtype} {shape}, {in_kilobytes(value.nbytes)}"))
    return rows


def _leaves(value: Any) -> Iterator[tuple[str, str]]:
    """Flatten nested values to dotted names and short texts."""
    for name, leaf in _flat(value):
        yield name, f"{leaf:.6g}" if isinstance(leaf, float) else str(leaf)


def _flat(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Flatten nested values to dotted names and leaves."""
    if isinstance(value, dict):
        for key, item in value.items():
            yield from _flat(item, f"{name}.{key}" if name else str(key))
    else:
        yield name, value


def _score(name: str, value: Any) -> str:
    """Format a score with its unit and what is better, where these are known."""
    unit, better = next((found for part, *found in SCORES if re.search(part, name)), ("", ""))
    if isinstance(value, float):
        rounded = f"{value * (100 if unit == ' %' else 1):.4g}"
        value = f"{float(rounded):g}"  # no exponent below a million
    return f"{value}{unit}{better}"


def _triple(values: np.ndarray) -> str:
    return "(" + ", ".join(f"{value:.1f}" for value in values) + ")"
