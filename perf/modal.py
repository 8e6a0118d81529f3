"""Modal analysis and synthesis, object by object: `python perf/modal.py [--workspace DIR] [KEY ...]`.

Run `objectfolder build voxelize` first. Each object gets a fresh single-threaded process; times are CPU
seconds. The eigensolver calls of other projects run on the same matrices in the same process. Exits with 1
if a target is missed.
"""

import argparse
import resource
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse.linalg as sla
import torch
from harness import add_objects, chosen_objects, exit_with_verdict, fresh, parsed, run_job, write_record
from rich.console import Console
from rich.table import Table

from objectfolder.base.arrays import read_npz
from objectfolder.base.materials import material
from objectfolder.mesh.ply import read_surface
from objectfolder.mesh.sampling import sample_surface
from objectfolder.mesh.topology import Mesh
from objectfolder.sound.fem.adaptive import refine_grid
from objectfolder.sound.fem.eigen import solve_modes
from objectfolder.sound.fem.elasticity import Solid
from objectfolder.sound.fem.elements import solid_from_arrays
from objectfolder.sound.fem.modal import MIN_FREQUENCY, Request, refined_analysis
from objectfolder.sound.fem.settings import FineGrids
from objectfolder.sound.synthesis import sinusoid_bank
from objectfolder.workspace import params
from objectfolder.workspace.layout import Build

ROOT = Path(__file__).parents[1]
MAX_SECONDS = 180.0  # of the modal stage
MIN_FASTER = {"deepmodal": 5.0, "neuralsound": 2.5, "naive_loop": 150.0}
PEER_STEP = 100  # modes added per call of DeepModal
# The peers take minutes on objects up to this size, hours beyond.
PEER_DOF, PEER_MODES = 50_000, 300
STRIKES, NAIVE_STRIKES = 300, 4  # times three axes
SAMPLE_RATE, DURATION = 48000, 2.0  # at which every mode below 20 kHz sounds


def timed(function: Callable[[], Any]) -> tuple[Any, float]:
    start = time.process_time()
    return function(), time.process_time() - start


def load(workspace: str, key: str) -> tuple[Solid, Mesh, dict, dict]:
    """Return the first grid, its surface, the object's entry and the section `modal`."""
    values, build = params.read(Path(workspace) / "params.yaml"), Build(key, workspace)
    solid, surface = solid_from_arrays(read_npz(build.solid, "kind")), read_surface(build.solid_surface)
    return solid, surface, values["objects"][key], values["modal"]


def measure(workspace: str, key: str) -> dict:
    """Measure the stage `modal` and the synthesis in this process."""
    solid, solid_surface, entry, section = load(workspace, key)
    surface = read_surface(Build(key, workspace).surface)
    points = sample_surface(*surface, len(surface[0]) + section["surface_points"], np.random.default_rng(0))
    limits = section["max_frequency"], section["max_modes"]
    data, seconds = timed(
        lambda: refined_analysis(
            solid,
            solid_surface,
            FineGrids(**section["fine"]),
            points,
            Request(material(entry["material"]), float(entry["scale"]), *limits),
            key,
        )
    )
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    row = {"object": key, "seconds": seconds, "peak_mb": peak, "points": len(points)}
    wanted = (
        "resolution",
        "degrees_of_freedom",
        "modes",
        "count_below_max_frequency",
        "truncated",
        "residual_max",
    )
    row |= {name: data.report[name] for name in wanted}
    row["estimated_error"] = max(data.report["discretisation_error"] or [float("nan")])
    return row | synthesis(data.shapes[:STRIKES], data.damped_frequency, data.damping)


def synthesis(shapes: np.ndarray, damped_frequency: np.ndarray, damping: np.ndarray) -> dict:
    """Measure CPU time per sound: one product with the bank of all modes, and a loop over modes."""
    if not len(damping):
        return {}
    gains = torch.from_numpy(shapes).reshape(-1, len(damping))
    frequency, decay = torch.from_numpy(damped_frequency), torch.from_numpy(damping)
    sounds, own = timed(lambda: gains @ sinusoid_bank(frequency, decay, SAMPLE_RATE, DURATION))
    time_axis = np.arange(sounds.shape[1]) / SAMPLE_RATE

    def loop() -> np.ndarray:
        out = np.zeros((3 * NAIVE_STRIKES, len(time_axis)))
        for sound, gain in zip(out, gains.double().numpy()):
            for g, w, c in zip(gain, damped_frequency, damping):
                sound += g / w * np.exp(-c * time_axis) * np.sin(w * time_axis)
        return out

    naive, peer = timed(loop)
    assert np.allclose(sounds[: len(naive)].numpy(), naive, rtol=0, atol=1e-4 * np.abs(naive).max())
    return {
        "sounds": len(sounds),
        "synthesis_s": own,
        "synthesis_ms_per_sound": 1000 * own / len(sounds),
        "naive_ms_per_sound": 1000 * peer / len(naive),
    }


def compare(workspace: str, key: str) -> dict:
    """Time our solver and the peers' on the same matrices and frequency limit.

    DeepModal (analysis/FEM.py, compute_modes): `eigsh` around the middle of the band, by eigenvalue, with
    100 modes more until the band is covered. NeuralSound (src/classic/fem/solver.py, Lanczos_Solver):
    `eigsh` around zero, where the stiffness is singular; given the right number of modes here, which it
    would have to guess.
    """
    solid, surface, entry, section = load(workspace, key)
    stuff, scale, fine = material(entry["material"]), float(entry["scale"]), FineGrids(**section["fine"])
    fem = refine_grid(solid, surface, fine, stuff, scale, key).vibration.fem
    stiffness, mass = fem.stiffness.tocsc(), fem.mass.tocsc()
    limit = (2 * np.pi * section["max_frequency"]) ** 2
    middle = (limit + (2 * np.pi * MIN_FREQUENCY) ** 2) / 2
    modes, own = timed(lambda: solve_modes(fem, section["max_frequency"], section["max_modes"], key))

    def deepmodal() -> np.ndarray:
        count = PEER_STEP
        while True:
            found = sla.eigsh(stiffness, k=count, M=mass, which="LM", sigma=middle)[0]
            if found.max() >= limit:
                return found
            count += PEER_STEP

    def neuralsound() -> np.ndarray:
        return sla.eigsh(stiffness, k=len(modes.eigenvalues) + 6, M=mass, which="LM", sigma=0)[0]

    row: dict = {"object": key, "degrees_of_freedom": fem.stiffness.shape[0], "own_s": own}
    row["modes"] = len(modes.eigenvalues)
    for name, call in (("deepmodal", deepmodal), ("neuralsound", neuralsound)):
        try:
            values, row[f"{name}_s"] = timed(call)
        except (RuntimeError, sla.ArpackError) as error:
            row[f"{name}_failed"] = str(error)
            continue
        elastic = np.sort(values[values > (2 * np.pi * MIN_FREQUENCY) ** 2])[: len(modes.eigenvalues)]
        apart = np.abs(np.sqrt(elastic / modes.eigenvalues[: len(elastic)]) - 1)
        row[f"{name}_apart"] = float(apart.max()) if len(elastic) == len(modes.eigenvalues) else None
    return row


def misses(rows: list[dict], peers: list[dict]) -> list[str]:
    """Return the missed targets."""
    missed = [f"{row['object']}: crashed: {row['failed']}" for row in rows + peers if "failed" in row]
    for row in rows:
        if row.get("seconds", 0) > MAX_SECONDS:
            missed.append(f"{row['object']}: {row['seconds']:.0f} s, target {MAX_SECONDS:g} s")
        faster = row.get("naive_ms_per_sound", np.inf) / row.get("synthesis_ms_per_sound", 1)
        if faster < MIN_FASTER["naive_loop"]:
            missed.append(f"{row['object']}: synthesis {faster:.0f}x, target {MIN_FASTER['naive_loop']:g}x")
    for row in peers:
        for name in ("deepmodal", "neuralsound"):
            faster = row.get(f"{name}_s", np.inf) / row.get("own_s", 1)
            if faster < MIN_FASTER[name]:
                missed.append(f"{row['object']}: {name} {faster:.1f}x, target {MIN_FASTER[name]:g}x")
    return missed


def show(rows: list[dict], peers: list[dict], console: Console) -> None:
    table = Table(title="Modal stage; a naive loop over modes beside the synthesis of a sound")
    for title in ("object", "cells", "dof", "modes", "CPU s", "peak MB", "ms/sound", "naive ms", "x"):
        table.add_column(title, justify="left" if title == "object" else "right", no_wrap=True)
    for row in (row for row in rows if "failed" not in row):
        shown = [f"{row['resolution']}^3", f"{row['degrees_of_freedom']:,}", f"{row['modes']}"]
        shown += [f"{row['seconds']:.1f}", f"{row['peak_mb']:.0f}"]
        if "synthesis_s" in row:
            own, naive = row["synthesis_ms_per_sound"], row["naive_ms_per_sound"]
            shown += [f"{own:.2f}", f"{naive:.0f}", f"{naive / own:.0f}"]
        table.add_row(row["object"], *shown)
    console.print(table)
    for row in (row for row in peers if "failed" not in row):
        for name in ("deepmodal", "neuralsound"):
            verdict = (
                f"{row[f'{name}_s']:.1f} s, {row[f'{name}_s'] / row['own_s']:.1f}x"
                if f"{name}_s" in row
                else f"fails: {row[f'{name}_failed']}"
            )
            console.print(f"{row['object']}: solver {row['own_s']:.1f} s; call of {name} {verdict}")


def main() -> None:
    run_job({"measure": measure, "compare": compare})
    parser = argparse.ArgumentParser(description=__doc__)
    add_objects(parser)
    arguments = parsed(parser)
    console, keys = Console(width=max(Console().width, 120)), chosen_objects(arguments)
    rows = [{"object": key} | fresh(__file__, "measure", arguments.workspace, key) for key in keys]
    small = [
        row["object"]
        for row in rows
        if "failed" not in row
        and row["degrees_of_freedom"] <= PEER_DOF
        and row["count_below_max_frequency"] <= PEER_MODES
    ]
    peers = [{"object": key} | fresh(__file__, "compare", arguments.workspace, key) for key in small]
    show(rows, peers, console)
    missed = misses(rows, peers)
    faster = ", ".join(f"{times:g} times ({name.replace('_', ' ')})" for name, times in MIN_FASTER.items())
    targets = f"{MAX_SECONDS:g} s; faster by {faster}"
    write_record(arguments.json, {"objects": rows, "peers": peers}, targets, missed)
    exit_with_verdict(missed, console)


if __name__ == "__main__":
    main()
