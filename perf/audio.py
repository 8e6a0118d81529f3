"""Training and accuracy of the AudioNet `gains`: `python perf/audio.py [--workspace DIR] [KEY ...]`.

Run `objectfolder build modal` first. Each object is trained in a fresh single-threaded process with the
section `train_audio` of the workspace's params.yaml. The stored net is scored at surface points that
neither training nor early stopping used. Exits with 1 if a target is missed.
"""

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np
import torch
from harness import add_objects, chosen_objects, exit_with_verdict, fresh, parsed, run_job, write_record
from rich.console import Console
from rich.table import Table

from objectfolder.base.arrays import read_npz, read_safetensors, write_safetensors
from objectfolder.base.metrics import SpectrogramErrors, gain_errors
from objectfolder.base.seeding import torch_generator
from objectfolder.nets.fit import Session
from objectfolder.sound.gains_net import GainsNet, energy_weights
from objectfolder.sound.gains_training import ModeSamples, train_gains
from objectfolder.sound.net_settings import AudioConfig
from objectfolder.sound.spectrogram import SAMPLE_RATE, spectrogram
from objectfolder.sound.synthesis import is_audible, sinusoid_bank
from objectfolder.workspace import params
from objectfolder.workspace.layout import Build

ROOT = Path(__file__).parents[1]
FEW_MODES, MANY_MODES = 75, 200  # targets depend on the number of modes; above the larger there are none
IMPACTS = 200


TARGETS = (
    f"to {FEW_MODES} modes: energy 1 %, Frobenius 3 %, 85 dB, 30 above silence, 60 s, 70 kB and 0.8 a mode; "
    f"to {MANY_MODES}: energy 2 %, Frobenius 6 %, 90 s, 350 kB"
)


def targets(modes: int) -> dict[str, tuple[str, float]]:
    """Return the limits of an object with this number of modes, by figure."""
    if modes <= FEW_MODES:
        limits = {"gain_error": ("<=", 0.01), "gain_error_frobenius": ("<=", 0.03), "psnr": (">=", 85.0)}
        limits |= {"above_silence": (">=", 30.0), "seconds": ("<=", 60.0)}
        return limits | {"file_kb": ("<=", 70 + 0.8 * modes)}
    if modes <= MANY_MODES:
        limits = {"gain_error": ("<=", 0.02), "gain_error_frobenius": ("<=", 0.06)}
        return limits | {"seconds": ("<=", 90.0), "file_kb": ("<=", 350.0)}
    return {}


def measure(workspace: str, key: str) -> dict:
    """Train and score one object in this process."""
    torch.set_num_threads(1)
    values = params.read(Path(workspace) / "params.yaml")
    config = params.settings(AudioConfig, values)
    names = ("points", "shapes", "damped_frequency", "damping")
    modes = read_npz(Build(key, workspace).modes, *names, "split")
    points, shapes, damped, damping = (modes[name] for name in names)
    train, val, test = (np.flatnonzero(modes["split"] == i) for i in range(3))
    size = config.size(len(damping))
    generator = torch_generator(values["seed"], key, "train_audio")
    start = time.process_time()
    net, _ = train_gains(
        ModeSamples(points, shapes, damped, damping, train, val), size, config.batch, Session(generator)
    )
    row = {"object": key, "modes": len(damping), "points": len(train), "steps": size.steps}
    row["seconds"] = time.process_time() - start
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "audio.safetensors"
        tensors, header = net.to_tensors()
        write_safetensors(path, tensors, {"kind": config.net, "net": header})
        row["file_kb"] = path.stat().st_size / 1000
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
    """Return the PSNR of random unit impulses in the paper's convention, and its margin above silence."""
    heard = is_audible(torch.from_numpy(damped), SAMPLE_RATE)
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


def misses(row: dict) -> list[str]:
    """Return the targets that an object misses."""
    if "failed" in row:
        return [f"crashed: {row['failed']}"]
    return [
        f"{name} {row[name]:.4g}, target {sign} {limit:.4g}"
        for name, (sign, limit) in targets(row["modes"]).items()
        if name in row and not (row[name] <= limit if sign == "<=" else row[name] >= limit)
    ]


def show(rows: list[dict], console: Console) -> None:
    columns = {
        "object": ("object", ""),
        "modes": ("modes", "d"),
        "points": ("points", "d"),
        "steps": ("steps", "d"),
        "seconds": ("CPU s", ".0f"),
        "file_kb": ("kB", ".0f"),
        "gain_error": ("energy", ".2%"),
        "gain_error_frobenius": ("Frobenius", ".2%"),
        "worst_mode_error": ("worst mode", ".1%"),
        "worst_mode_hz": ("at Hz", ".0f"),
        "psnr": ("dB", ".1f"),
        "above_silence": ("above silence", ".1f"),
    }
    table = Table(title="AudioNet gains at held-out surface points")
    for name, (title, _) in columns.items():
        table.add_column(title, justify="left" if name == "object" else "right", no_wrap=True)
    for row in (row for row in rows if "failed" not in row):
        table.add_row(
            *(format(row[name], spec) if name in row else "-" for name, (_, spec) in columns.items())
        )
    console.print(table)


def main() -> None:
    run_job({"measure": measure})
    parser = argparse.ArgumentParser(description=__doc__)
    add_objects(parser)
    arguments = parsed(parser)
    console, keys = Console(width=max(Console().width, 130)), chosen_objects(arguments)
    rows = [{"object": key} | fresh(__file__, "measure", arguments.workspace, key) for key in keys]
    show(rows, console)
    missed = [f"{row['object']}: {text}" for row in rows for text in misses(row)]
    write_record(arguments.json, {"objects": rows}, TARGETS, missed)
    exit_with_verdict(missed, console)


if __name__ == "__main__":
    main()
