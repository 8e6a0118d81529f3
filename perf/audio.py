"""Training and accuracy of the AudioNet `gains`: `python perf/audio.py [--workspace DIR] [KEY ...]`.

Needs `objectfolder build modal`. Each object gets a fresh process with one thread, the section `train_audio`
of the workspace's params.yaml, and is scored, as stored, at surface points that neither training nor early
stopping has seen. Exits with 1 if a target is missed.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import torch
from rich.console import Console
from rich.table import Table

from objectfolder.audio.spectrogram import SAMPLE_RATE, spectrogram
from objectfolder.audio.synthesis import audible, sinusoid_bank
from objectfolder.io import atomic, read_npz, read_safetensors, write_safetensors
from objectfolder.metrics import SpectrogramErrors, gain_errors
from objectfolder.nets.audio_config import AudioConfig
from objectfolder.nets.audio_gains import GainsNet, energy_weights
from objectfolder.nets.audio_gains_training import train_gains
from objectfolder.seeding import torch_generator
from objectfolder.workspace import params
from objectfolder.workspace.layout import Build

ROOT = Path(__file__).parents[1]
FEW_MODES, MANY_MODES = 75, 200  # each has its targets; objects with more modes have none
IMPACTS = 200
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def targets(modes: int) -> dict[str, tuple[str, float]]:
    """Limits by figure, for an object's number of modes."""
    if modes <= FEW_MODES:
        limits = {"gain_error": ("<=", 0.01), "gain_error_frobenius": ("<=", 0.03), "psnr": (">=", 85.0)}
        limits |= {"above_silence": (">=", 30.0), "seconds": ("<=", 60.0)}
        return limits | {"file_kb": ("<=", 70 + 0.8 * modes)}
    if modes <= MANY_MODES:
        limits = {"gain_error": ("<=", 0.02), "gain_error_frobenius": ("<=", 0.06)}
        return limits | {"seconds": ("<=", 90.0), "file_kb": ("<=", 350.0)}
    return {}


def measure(workspace: Path, key: str) -> dict:
    """Train on one object, in this process."""
    torch.set_num_threads(1)
    values = params.read(workspace / "params.yaml")
    config = params.settings(AudioConfig, values)
    names = ("points", "shapes", "damped_frequency", "damping")
    modes = read_npz(Build(key, workspace).modes, *names, "split")
    points, shapes, damped, damping = (modes[name] for name in names)
    train, val, test = (np.flatnonzero(modes["split"] == i) for i in range(3))
    size = config.size(len(damping))
    generator = torch_generator(values["seed"], key, "train_audio")
    start = time.process_time()
    net, _ = train_gains(points, shapes, damped, damping, train, val, size, config.batch, generator)
    row = {"object": key, "modes": len(damping), "points": len(train), "steps": size.steps}
    row["seconds"] = time.process_time() - start
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "audio.safetensors"
        tensors, header = net.to_tensors()
        write_safetensors(path, tensors, {"kind": config.net, "net": header})
        row["file_kb"] = path.stat().st_size / 1024
        tensors, header = read_safetensors(path)
    stored = GainsNet.from_tensors(tensors, header["net"])
    predicted = stored.shapes(torch.from_numpy(points[test])).double().numpy()
    truth = shapes[test].astype(np.float64)
    row |= gain_errors(predicted, truth, energy_weights(damped, damping), 1 / damped)
    worst = np.sqrt(((predicted - truth) ** 2).sum((0, 1)) / (truth**2).sum((0, 1)))
    row |= {"worst_mode": int(worst.argmax()) + 1, "worst_mode_error": float(worst.max())}
    row["worst_mode_hz"] = float(damped[worst.argmax()] / (2 * np.pi))
    return row | loudness(predicted, truth, damped, damping)


def loudness(predicted: np.ndarray, truth: np.ndarray, damped: np.ndarray, damping: np.ndarray) -> dict:
    """PSNR in the paper's convention of random unit impulses, and how far it lies above silence."""
    heard = audible(torch.from_numpy(damped), SAMPLE_RATE)
    if not heard.any():
        return {}
    bank = spectrogram(sinusoid_bank(torch.from_numpy(damped), torch.from_numpy(damping)))
    rng = np.random.default_rng(0)
    force = rng.normal(size=(IMPACTS, 3))
    force /= np.linalg.norm(force, axis=1, keepdims=True)
    chosen = rng.integers(len(truth), size=IMPACTS)
    image, true = (
        torch.from_numpy(np.einsum("na,nam->nm", force, s[chosen])).to(bank.dtype) for s in (predicted, truth)
    )
    errors = SpectrogramErrors()
    for g, g_true in zip(image.split(16), true.split(16)):
        errors.add(torch.tensordot(g, bank, 1), torch.tensordot(g_true, bank, 1))
    scores = errors.scores()
    return scores | {"above_silence": scores["psnr"] - scores["baseline_silence"]}


def fresh(workspace: Path, key: str) -> dict:
    """Run this file for one object in a process of its own."""
    done = subprocess.run(
        [sys.executable, __file__, "--job", "--workspace", str(workspace), key],
        capture_output=True,
        text=True,
        env={**os.environ, **dict.fromkeys(THREADS, "1")},
    )
    if done.returncode:
        return {"object": key, "failed": done.stderr.strip().splitlines()[-1:]}
    return json.loads(done.stdout.splitlines()[-1])


def misses(row: dict) -> list[str]:
    """Targets that an object misses."""
    if "failed" in row:
        return [f"crashed: {row['failed']}"]
    return [
        f"{name} {row[name]:.4g}, target {sign} {limit:.4g}"
        for name, (sign, limit) in targets(row["modes"]).items()
        if name in row and not (row[name] <= limit if sign == "<=" else row[name] >= limit)
    ]


def show(rows: list[dict], console: Console) -> None:
    table = Table(title="AudioNet gains at held-out surface points")
    form = {
        "object": str,
        "modes": str,
        "points": str,
        "steps": str,
        "seconds": lambda v: f"{v:.0f}",
        "file_kb": lambda v: f"{v:.0f}",
        "gain_error": lambda v: f"{v:.2%}",
        "gain_error_frobenius": lambda v: f"{v:.2%}",
        "worst_mode_error": lambda v: f"{v:.1%}",
        "worst_mode_hz": lambda v: f"{v:.0f}",
        "psnr": lambda v: f"{v:.1f}",
        "above_silence": lambda v: f"{v:.1f}",
    }
    titles = (
        "object",
        "modes",
        "points",
        "steps",
        "CPU s",
        "KB",
        "energy",
        "Frobenius",
        "worst mode",
        "at Hz",
    )
    for title in (*titles, "dB", "above silence"):
        table.add_column(title, justify="left" if title == "object" else "right", no_wrap=True)
    for row in (row for row in rows if "failed" not in row):
        table.add_row(*(f(row[name]) if name in row else "-" for name, f in form.items()))
    console.print(table)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("keys", nargs="*", help="objects (default: all of params.yaml)")
    parser.add_argument("--workspace", type=Path, default=ROOT, help="holds params.yaml and build/")
    parser.add_argument("--json", type=Path, help="also write the figures here")
    parser.add_argument("--job", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.job:
        print(json.dumps(measure(arguments.workspace, arguments.keys[0])))
        return
    keys = arguments.keys or list(params.read(arguments.workspace / "params.yaml")["objects"])
    console = Console(width=max(Console().width, 130))
    rows = [fresh(arguments.workspace, key) for key in keys]
    show(rows, console)
    if arguments.json:
        with atomic(arguments.json) as path:
            path.write_text(json.dumps({"objects": rows}, indent=2) + "\n")
    missed = [f"{row['object']}: {reason}" for row in rows for reason in misses(row)]
    console.print(
        "targets: " + ("; ".join(missed) if missed else f"met by all {len(rows)}"),
        markup=False,
        soft_wrap=True,
    )
    sys.exit(bool(missed))


if __name__ == "__main__":
    main()
