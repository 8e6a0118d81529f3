"""Sound while a striker touches: `python perf/contact.py FILE... [--strikes N]`.

Compares what a listener hears of the modes of Object Files, or of samples such as mug, during the contact
with a Fourier transform: the modes' acceleration at all frequencies times the pressure that each has per
acceleration at its own frequency, taken for all. How a field changes away from its mode's frequency is
therefore in neither; nor is the click of the recoil. Exits with 1 if a target is missed.
"""

import argparse
from pathlib import Path

import numpy as np
import torch
from harness import exit_with_verdict, parsed, write_record
from rich.console import Console
from rich.table import Table

from objectfolder import ObjectFile
from objectfolder.objectfile.samples import file_or_sample
from objectfolder.sound.click import SOUND_SPEED, recoil_pressure
from objectfolder.sound.contact import striker_names

RATE, SECONDS = 44100, 0.1
OVER = 8  # the reference has as many times the samples
LISTENER = np.array([[0.6, -0.6, 0.5]])  # metres from the centre
ERROR, THUMP = -10.0, 0.01  # dB of the sound during the contact; share of the energy
TARGETS = (
    f"error of {ERROR:g} dB during the contact; {100 * THUMP:g} % of the energy below half the lowest mode"
)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("files", nargs="+", type=Path)
    parser.add_argument("--strikes", type=int, default=8, help="at random points of each object")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path, help="file for the figures")
    given = parsed(parser)
    console, rows = Console(), []
    table = Table("object", "striker", "contact, ms", "error, dB", "energy below, %")
    for path in given.files:
        file = ObjectFile.load(file_or_sample(path))
        for name in striker_names():
            row = {"object": file.key, "striker": name} | compared(file, name, given.strikes, given.seed)
            rows.append(row)
            figures = 1000 * row["contact"], row["error"], 100 * row["below"]
            table.add_row(file.key, name, *(f"{figure:.3g}" for figure in figures))
    console.print(table)
    missed = [
        f"{row['striker']} on {row['object']}: {row['error']:.1f} dB, {100 * row['below']:.2g} %"
        for row in rows
        if row["error"] > ERROR or row["below"] > THUMP
    ]
    write_record(given.json, {"rows": rows, "strikes": given.strikes, "seed": given.seed}, TARGETS, missed)
    exit_with_verdict(missed, console)


def compared(file: ObjectFile, striker: str, strikes: int, seed: int) -> dict[str, float]:
    """Return the contact time, the error during it in dB of the sound, and the share of energy too low."""
    surface = file.surface
    chosen = np.random.default_rng(seed).integers(len(surface.vertices), size=strikes)
    points, impulses = surface.vertices[chosen] * file.scale, -0.01 * surface.normals[chosen]
    contact = file.contact_time(striker)
    heard = file.impact(points, impulses, RATE, SECONDS, striker=striker, listener=LISTENER)
    body = file._parts.radiation.recoil(file.voice(RATE).material.density, file.scale)
    heard = heard - recoil_pressure(
        body, impulses, np.tile(LISTENER, (strikes, 1)), RATE, heard.shape[1], contact
    )
    expected = reference(file, points, impulses, contact)
    during = slice(0, int(contact * RATE) + 1)
    error, size = (np.square(x[:, during]).mean() ** 0.5 for x in (heard - expected, expected))
    energy, hertz = abs(np.fft.rfft(heard)) ** 2, np.fft.rfftfreq(heard.shape[1], 1 / RATE)
    low = hertz < file.tuning().frequencies.min().item() / 2
    return {
        "contact": contact,
        "error": 20 * float(np.log10(error / size)),
        "below": float(energy[:, low].sum() / energy.sum()),
    }


def reference(file: ObjectFile, points: np.ndarray, impulses: np.ndarray, contact: float) -> np.ndarray:
    """Return the sound of the modes, by acceleration at all frequencies; (strikes, samples)."""
    count = 1 << 18
    tuning = file.tuning()
    s = torch.complex(-tuning.damping.double(), tuning.damped_frequency.double()).numpy()
    kept = s.imag < np.pi * RATE
    s, gains = s[kept], np.einsum("nc,ncm->nm", impulses, file.mode_shapes(points))[:, kept]
    pressure = file._parts.radiation.field.pressure(s.imag / SOUND_SPEED, LISTENER)[0].conj()
    time = np.arange(count) / (OVER * RATE)
    force = np.where(time < contact, np.pi / (2 * contact) * np.sin(np.pi * time / contact), 0)
    w = 2 * np.pi * OVER * RATE * np.fft.rfftfreq(count)
    moved = np.zeros((len(points), len(w)), complex)
    for gain, p, pole in zip(gains.T, pressure, s):
        moved -= np.outer(gain, p * w**2 / ((1j * w - pole) * (1j * w - pole.conj())))
    return np.fft.irfft(moved * np.fft.rfft(force), count)[:, : round(RATE * SECONDS) * OVER : OVER]


if __name__ == "__main__":
    main()
