"""Grasps: do labels depend on the time step, and how many are there per second?

`python perf/grasp.py labels FILE FILE FILE [--json FILE]`: the same grasps, half of them successes, with a
time step of 0.25 ms and with longer ones, for several settings of contacts. Exits with 1 if fewer than 97 %
agree at 1 ms, the time step of the larger presets, with the settings that the library uses. Objects have the
hulls of the environments, 16 at most.

`python perf/grasp.py speed FILE ... [--json FILE]`: labelled grasps per second, with and without pictures.
"""

import argparse
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from harness import parsed, write_record
from rich.console import Console
from rich.table import Table

from objectfolder.base.seeding import numpy_generator
from objectfolder.benchmarks.datasets.grasp_data import (
    BATCH,
    Attempts,
    GraspDataConfig,
    collect_grasps,
    draw_attempts,
    label_grasps,
)
from objectfolder.benchmarks.tasks.running import machine
from objectfolder.objectfile.file import ObjectFile
from objectfolder.sim.body import RigidBody, rigid_body, user_folder
from objectfolder.sim.grasp_scene import GraspScene, Physics
from objectfolder.sim.hulls import cached_hulls

REFERENCE = 0.00025  #: time step, s
STEPS = (0.001, 0.002, 0.004)
SETTINGS = {
    "as used": Physics(),
    "impratio 1": Physics(impratio=1.0),
    "pyramidal cone": Physics(cone="pyramidal"),
    "jaws close at 1 m/s": Physics(speed=1.0),
}
TARGET = 0.97
SPEED_TARGETS = {"labels": 15.0, "pictures and touches": 5.0}  #: grasps per second on two cores


def balanced(body: RigidBody, count: int, seed: int, threads: int) -> Attempts:
    """Grasps that both pads touch; half of them succeed as the library simulates them."""
    scene = GraspScene(body, threads=threads)
    rests = scene.rests(numpy_generator(seed, body.key, "rests"))
    found: dict[bool, list[Attempts]] = {True: [], False: []}
    batch = 0
    while min(sum(len(part.forces) for part in parts) for parts in found.values()) < count // 2:
        attempts, _ = draw_attempts(scene, rests, BATCH, numpy_generator(seed, body.key, "study", str(batch)))
        grasps = scene.grasp(*vars(attempts).values())
        for outcome, parts in found.items():
            parts.append(attempts.take(np.flatnonzero(grasps.touched.all(1) & (grasps.success == outcome))))
        batch += 1
    halves = [
        Attempts(
            *(np.concatenate(values)[: count // 2] for values in zip(*(vars(p).values() for p in parts)))
        )
        for parts in found.values()
    ]
    return Attempts(*(np.concatenate(values) for values in zip(*(vars(half).values() for half in halves))))


def study(bodies: list[RigidBody], count: int, seed: int, threads: int) -> list[dict]:
    """Agreement of labels with those of the reference's time step, for each setting."""
    attempts = {body.key: balanced(body, count, seed, threads) for body in bodies}
    rows = []
    for name, physics in SETTINGS.items():
        steps = (REFERENCE, *STEPS)
        outcomes: dict[float, list[np.ndarray]] = {step: [] for step in steps}
        cpu = dict.fromkeys(steps, 0.0)
        for body in bodies:
            for step in steps:
                scene = GraspScene(body, replace(physics, timestep=step), threads)
                start = time.process_time()
                outcomes[step].append(scene.grasp(*vars(attempts[body.key]).values()).success)
                cpu[step] += time.process_time() - start
        reference = np.concatenate(outcomes[REFERENCE])
        for step in STEPS:
            labels = np.concatenate(outcomes[step])
            rows.append(
                {
                    "setting": name,
                    "timestep_ms": 1000 * step,
                    "agreement": float((labels == reference).mean()),
                    "by_object": {
                        body.key: float((a == b).mean())
                        for body, a, b in zip(bodies, outcomes[step], outcomes[REFERENCE])
                    },
                    "trials": len(labels),
                    "successes": float(labels.mean()),
                    "trials_per_cpu_second": len(labels) / cpu[step],
                }
            )
            print(rows[-1], file=sys.stderr, flush=True)
    return rows


def speed(
    files: list[ObjectFile],
    count: int,
    perturbations: int,
    image: int,
    touch: tuple[int, int],
    seed: int,
    threads: int,
) -> list[dict]:
    """Grasps per second of each object, alone on the machine."""
    rows = []
    for file in files:
        body = rigid_body(file, cached_hulls(file, user_folder()))
        scene = GraspScene(body, threads=threads)
        rests = scene.rests(numpy_generator(seed, body.key, "rests"))
        start = time.perf_counter()
        labelled = 0
        while labelled < count:
            rng = numpy_generator(seed, body.key, "speed", str(labelled))
            labelled += len(label_grasps(scene, rests, perturbations, rng)[0].success)
        labels = labelled / (time.perf_counter() - start)
        with tempfile.TemporaryDirectory() as folder:
            start = time.perf_counter()
            wanted = GraspDataConfig(
                grasps=count,
                perturbations=perturbations,
                image=image,
                touch=touch,
                timestep=scene.physics.timestep,
            )
            collect_grasps(file, body, wanted, seed, folder, threads=threads)
            whole = count / (time.perf_counter() - start)
        rows.append(
            {"object": file.key, "hulls": len(body.hulls), "labels": labels, "pictures and touches": whole}
        )
        print(rows[-1], file=sys.stderr, flush=True)
    return rows


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=("labels", "speed"))
    parser.add_argument("files", type=Path, nargs="+", help="Object Files")
    parser.add_argument("--count", type=int, default=104, help="grasps of each object")
    parser.add_argument("--perturbations", type=int, default=2)
    parser.add_argument("--image", type=int, default=64)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path, help="file for the figures")
    given = parsed(parser)
    torch.set_num_threads(1)
    files = [ObjectFile.load(path) for path in given.files]
    if given.what == "labels":
        bodies = [rigid_body(file, cached_hulls(file, user_folder())) for file in files]
        rows = study(bodies, given.count, given.seed, given.threads)
        targets = f"{TARGET:.0%} as used, at 1 ms"
        missed = [
            f"{row['agreement']:.1%} at 1 ms"
            for row in rows
            if row["setting"] == "as used" and row["timestep_ms"] == 1 and row["agreement"] < TARGET
        ]
    else:
        rows = speed(
            files, given.count, given.perturbations, given.image, (64, 48), given.seed, given.threads
        )
        targets = ", ".join(f"{name} {target:g}" for name, target in SPEED_TARGETS.items())
        missed = [
            f"{row['object']}, {name}: {row[name]:.1f}"
            for row in rows
            for name, target in SPEED_TARGETS.items()
            if row[name] < target
        ]
    columns = [name for name in rows[0] if name != "by_object"]
    table = Table(*columns, title=f"Grasps, {machine('cpu')}")
    for row in rows:
        table.add_row(
            *(f"{v:.3g}" if isinstance(v, float) else str(v) for v in (row[name] for name in columns))
        )
    Console(width=160).print(table)
    write_record(given.json, {"seed": given.seed, "rows": rows}, targets, missed)
    return int(bool(missed))


if __name__ == "__main__":
    sys.exit(main())
