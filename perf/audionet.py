"""The paper's AudioNet over silence: `python perf/audionet.py WORKSPACE/build/KEY ... [--steps N]`.

Run `objectfolder build modal` first. Trains AudioNet ``spectrogram`` on the modes of each object with preset
faithful-small, in a fresh single-threaded process: target ``turned`` and, with --paper, the paper's;
scores the stored net on strikes at held-out points. Exits with 1 if a target is missed.
"""

import argparse
import tempfile
import time
from pathlib import Path
from statistics import mean

import numpy as np
import torch
from harness import (
    ROOT,
    beyond,
    exit_with_verdict,
    failures,
    fresh,
    parsed,
    print_rows,
    run_job,
    write_record,
)
from rich.console import Console

from objectfolder.base.arrays import read_npz, read_safetensors, write_safetensors
from objectfolder.base.metrics import SpectrogramErrors
from objectfolder.base.seeding import numpy_generator, torch_generator
from objectfolder.nets.fit import Session
from objectfolder.sound.evaluation import UnitStrikes
from objectfolder.sound.gains_training import ModeSamples
from objectfolder.sound.net_settings import AudioConfig
from objectfolder.sound.spectrogram import spectrogram
from objectfolder.sound.spectrogram_net import SpectrogramNet
from objectfolder.sound.spectrogram_training import train_spectrogram
from objectfolder.sound.synthesis import gains, sinusoid_bank
from objectfolder.workspace import params
from objectfolder.workspace.presets import read_preset

PRESET, IMPACTS, BATCH = "faithful-small", 64, 4
LEAST, LEAST_MEAN, MOST_MINUTES = 4.0, 8.0, 10.0  #: dB above silence, CPU minutes
TARGETS = f">= {LEAST_MEAN:g} dB above silence, none under {LEAST:g}, in {MOST_MINUTES:g} CPU min"
FORM = {
    "object": ("object", ""),
    "target": ("target", ""),
    "modes": ("modes", "d"),
    "steps": ("steps", "d"),
    "minutes": ("CPU min", ".1f"),
    "psnr": ("dB", ".1f"),
    "baseline_silence": ("silence", ".1f"),
    "above_silence": ("above silence", ".2f"),
}


def measure(folder: str, target: str, steps: str) -> dict:
    """Train and score one object in this process."""
    torch.set_num_threads(1)
    key = Path(folder).name
    values, _ = read_preset(PRESET, ROOT)
    chosen = {"target": target, "steps": int(steps) or values["train_audio"]["spectrogram"]["steps"]}
    chosen |= {"loud": 0.0, "final_rate": 1.0} if target == "paper" else {}
    values["train_audio"]["spectrogram"].update(chosen)
    config = params.settings(AudioConfig, values).spectrogram
    modes = read_npz(Path(folder) / "modes.npz", "points", "shapes", "damped_frequency", "damping", "split")
    tuning = modes["damped_frequency"], modes["damping"]
    train, val, test = (np.flatnonzero(modes["split"] == part) for part in range(3))
    session = Session(torch_generator(values.get("seed", 0), key, "train_audio"))
    start = time.process_time()
    net, _ = train_spectrogram(
        ModeSamples(modes["points"], modes["shapes"], *tuning, train, val), config, session
    )
    row = {"object": key, "target": target, "modes": len(tuning[0]), "steps": config.steps}
    row["minutes"] = (time.process_time() - start) / 60
    with tempfile.TemporaryDirectory() as place:
        path = Path(place) / "audio.safetensors"
        tensors, header = net.to_tensors()
        write_safetensors(path, tensors, {"kind": net.kind, "net": header})
        tensors, header = read_safetensors(path)
    stored = SpectrogramNet.from_tensors(tensors, header["net"])
    row |= above_silence(stored, modes, UnitStrikes.random(test, IMPACTS, numpy_generator(0, key, "strikes")))
    return row


def above_silence(
    net: SpectrogramNet, modes: dict[str, np.ndarray], strikes: UnitStrikes
) -> dict[str, float]:
    """Return the PSNR of strikes in the paper's convention, that of silence, and the margin."""
    bank = sinusoid_bank(*(torch.from_numpy(modes[name]) for name in ("damped_frequency", "damping")))
    errors = SpectrogramErrors()
    for start in range(0, len(strikes.rows), BATCH):
        some = strikes[start : start + BATCH]
        impulses = torch.from_numpy(some.impulses).float()
        truth = spectrogram(gains(torch.from_numpy(modes["shapes"][some.rows]).float(), impulses) @ bank)
        branches = net.spectrograms(torch.from_numpy(modes["points"][some.rows]))
        errors.add(torch.einsum("na,naft->nft", impulses.to(branches.dtype), branches), truth)
    scores = errors.scores()
    return scores | {"above_silence": scores["psnr"] - scores["baseline_silence"]}


def main() -> None:
    run_job({"measure": measure})
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", nargs="+", type=Path, help="build folders of objects, with modes.npz")
    parser.add_argument("--steps", type=int, default=0, help="default: the preset's")
    parser.add_argument("--paper", nargs="*", default=[], help="objects trained on the paper's target, too")
    parser.add_argument("--json", type=Path, help="file for the figures")
    arguments = parsed(parser)
    jobs = [(folder, "turned") for folder in arguments.folders]
    jobs += [(folder, "paper") for folder in arguments.folders if folder.name in arguments.paper]
    rows = []
    for folder, target in jobs:
        rows.append({"object": folder.name} | fresh(__file__, "measure", folder, target, arguments.steps))
        print_rows(rows[-1:], "", FORM, Console())
    learned = [row for row in rows if row.get("target") == "turned"]
    missed = failures(rows) + beyond(learned, {"above_silence": LEAST}, "dB", least=True)
    missed += beyond(learned, {"minutes": MOST_MINUTES}, "CPU min")
    if learned and (found := mean(row["above_silence"] for row in learned)) < LEAST_MEAN:
        missed.append(f"mean above silence: {found:.2f} dB, target {LEAST_MEAN:g} dB")
    write_record(arguments.json, {"preset": PRESET, "rows": rows}, TARGETS, missed)
    exit_with_verdict(missed, Console())


if __name__ == "__main__":
    main()
