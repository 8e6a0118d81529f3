"""Speed of the build engine: `python perf/engine.py COMMAND [--objects N ...] [--workers N] [--json FILE]`.

`scale` builds N objects with the stages, dependencies, parameters and outputs of dvc.yaml but commands that
only write a line: a first build, a no-op build and one changed material. For comparison it runs `dvc repro`
on the same workspace for a minute. `efficiency` runs eight objects with three stages of two seconds each.
`starter` builds the starter catalogue twice from scratch, with this engine and with `dvc repro` (an hour).
Times are wall seconds; peak memory is that of the engine. Exits with 1 if a target is missed.
"""

import argparse
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from harness import fresh, parsed, require, run_job, write_record
from rich.console import Console
from rich.table import Table
from ruamel.yaml import YAML

from objectfolder.engine.build import BuildOptions, build
from objectfolder.engine.summary import StageOutcome

ROOT = Path(__file__).parents[1]
PEER_SECONDS, IDLE_SECONDS = 60.0, 180.0  # limits of DVC alone: first build, no-op build
MAX_OVERHEAD_MS = 60.0  # per stage
MAX_IDLE = {100: (5.0, None), 1000: (60.0, 1024.0)}  # objects: seconds, MB
RERUN = 5  # stages that a changed material reruns: modal, radiation, train_audio, pack, evaluate
MIN_EFFICIENCY = 0.92
COLUMNS, STAGES, SECONDS = 8, 3, 2.0
MATERIALS = "ceramic", "steel"


def dummy(root: Path, objects: int) -> Path:
    """Create a workspace with the real graph, whose commands write a digest of their declared inputs."""
    keys = [f"object_{number:04d}" for number in range(objects)]
    new_repository(root)
    for name in (".gitignore", ".dvcignore"):
        shutil.copy(ROOT / name, root)
    for name in ("objectfolder", "stages"):
        shutil.copytree(ROOT / name, root / name, ignore=shutil.ignore_patterns("__pycache__"))
    graph = YAML(typ="safe").load(ROOT / "dvc.yaml")
    del graph["stages"]["generate"]
    for name, stage in graph["stages"].items():
        if name == "hash_code":
            continue  # its own command: the engine checks the modules that it lists
        definition = stage.get("do", stage)
        (root / f"{name}.sh").write_text(script(name, definition))
        definition["cmd"] = f"sh {name}.sh ${{key}}"
    YAML().dump(graph, root / "dvc.yaml")
    values = YAML(typ="safe").load(ROOT / "params.yaml")
    entry = values["objects"]["mug"] | {"material": MATERIALS[0]}
    values["procedural"] = {}
    values["objects"] = {key: entry | {"mesh": f"data/objects/{key}/mesh.glb"} for key in keys}
    plain = YAML()
    plain.representer.ignore_aliases = lambda _: True
    plain.dump(values, root / "params.yaml")
    for key in keys:
        (root / "data/objects" / key).mkdir(parents=True)
        (root / "data/objects" / key / "mesh.glb").write_text(key)
    dvc(root, "add", *(f"data/objects/{key}" for key in keys))
    return root


def script(name: str, definition: dict) -> str:
    """Return the shell script of a stage, which writes a digest of the inputs to each output."""
    inputs = [dep.replace("${key}", "$1") for dep in definition["deps"] if dep.startswith("build/${key}")]
    material = "material" in str(definition.get("params", ""))
    lines = [
        "set -e",
        "mkdir -p metrics build/$1",
        f"digest=$(cat {' '.join([*inputs, '/dev/null'])} | md5sum)",
        f'digest="{name} $1 $digest"',
    ]
    if material:
        lines.append(
            'digest="$digest $(grep -A 9 "^  $1:" ${OBJECTFOLDER_PARAMS:-params.yaml} | grep -m 1 material)"'
        )
    outs = definition.get("outs", []) + [next(iter(m)) for m in map(dict, plain_metrics(definition))]
    for out in (out.replace("${key}", "$1") for out in outs):
        if out.startswith("metrics/"):
            lines.append(f'echo "{{\\"psnr\\": 40}}" > {out}')
        elif Path(out).suffix:
            lines.append(f"echo {out} $digest > {out}")
        else:
            lines.append(f"mkdir -p {out}")
            lines += [f"echo {file} $digest > {out}/{file}" for file in SPLITS]
    return "\n".join(lines) + "\n"


TARGETS = {
    "scale": f"{MAX_OVERHEAD_MS:g} ms a stage; nothing to do: "
    + ", ".join(f"{limits[0]:g} s for {objects} objects" for objects, limits in MAX_IDLE.items())
    + f", 1,024 MB; {RERUN} stages",
    "efficiency": f"{MIN_EFFICIENCY:.0%}",
    "starter": "",
}
SPLITS = ("train.npz", "val.npz", "test.npz")


def plain_metrics(definition: dict) -> list[dict]:
    """Return the metrics of a stage, each as a mapping from path to options."""
    return [m if isinstance(m, dict) else {m: {}} for m in definition.get("metrics", [])]


def columns(root: Path, count: int, stages: int, seconds: float) -> Path:
    """Create a workspace of independent chains whose commands only sleep."""
    new_repository(root)
    lines = ["stages:"]
    for column in range(count):
        for stage in range(stages):
            dep = f"build/{column}_{stage - 1}" if stage else "params.yaml"
            out = f"build/{column}_{stage}"
            lines.append(
                f"  s{stage}_{column}: {{cmd: sleep {seconds} && echo > {out}, deps: [{dep}], outs: [{out}]}}"
            )
    (root / "dvc.yaml").write_text("\n".join(lines) + "\n")
    (root / "params.yaml").write_text("{}\n")
    (root / "build").mkdir()
    return root


def new_repository(root: Path) -> None:
    root.mkdir(parents=True)
    subprocess.run(["git", "init", "-q", root], check=True)
    (root / ".dvc").mkdir()
    shutil.copy(ROOT / ".dvc/config", root / ".dvc")


def run_build(root: str, workers: str) -> dict:
    """Build once; the job of a fresh process."""
    start, cpu = time.monotonic(), time.process_time()
    summary = build(options=BuildOptions(jobs=int(workers)), root=root)
    if not summary.ok:
        sys.exit(f"{summary.failures[0].address}: {summary.failures[0].error}")
    return {
        "seconds": time.monotonic() - start,
        "cpu_s": time.process_time() - cpu,
        "stages": len(summary.stages),
        "ran": len(summary.with_status(StageOutcome.RAN)),
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }


def built(root: Path, workers: int) -> dict:
    """Build in a fresh process."""
    return require(fresh(__file__, "build", root, workers))


def dvc(root: Path, *arguments: str, limit: float | None = None) -> float | None:
    """Return the wall seconds of a DVC command, or None if it was stopped at the limit."""
    start = time.monotonic()
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    process = subprocess.Popen(
        [sys.executable, "-m", "dvc", *arguments],
        cwd=root,
        env={**os.environ, "PATH": path, "PYTHONPATH": ""},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        if process.wait(limit):
            sys.exit(f"dvc {' '.join(arguments)} failed in {root}")
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        return None
    return time.monotonic() - start


def scale(folder: Path, workers: int, objects: int) -> dict:
    """Measure a first build, a no-op build, a changed material, and DVC alone."""
    root, peer = dummy(folder / "own", objects), folder / "peer"
    shutil.copytree(root, peer, symlinks=True)
    row = {
        "objects": objects,
        "workers": workers,
        "first": built(root, workers),
        "idle": built(root, workers),
    }
    params = root / "params.yaml"
    text = params.read_text()
    params.write_text(text.replace(f"material: {MATERIALS[0]}", f"material: {MATERIALS[1]}", 1))
    row["changed"] = built(root, workers)
    row["status_s"] = dvc(root, "status", limit=IDLE_SECONDS)
    row["peer_idle_s"] = dvc(root, "repro", limit=IDLE_SECONDS)
    seconds = dvc(peer, "repro", limit=PEER_SECONDS) or PEER_SECONDS
    lock = peer / "dvc.lock"
    done = len(re.findall(r"^  \S+:$", lock.read_text(), re.MULTILINE)) if lock.exists() else 0
    return row | {"peer_stages": done, "peer_s": seconds}


def efficiency(folder: Path, workers: int, _: int) -> dict:
    """Measure the share of the workers' time that is spent in commands."""
    ran = built(columns(folder / "own", COLUMNS, STAGES, SECONDS), workers)
    work = COLUMNS * STAGES * SECONDS
    return {"workers": workers, "seconds": ran["seconds"], "efficiency": work / workers / ran["seconds"]}


def starter(folder: Path, workers: int, _: int) -> dict:
    """Build the starter catalogue from scratch, with this engine and with DVC alone."""
    for name in ("own", "peer"):
        subprocess.run(["git", "clone", "-q", ROOT, folder / name], check=True)
    start = time.monotonic()
    subprocess.run(
        [sys.executable, "-c", "from objectfolder.cli import main; main()", "build", "-j", str(workers)],
        cwd=folder / "own",
        check=True,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    own = time.monotonic() - start
    peer = dvc(folder / "peer", "repro")
    return {"workers": workers, "own_s": own, "peer_s": peer}


def lines(command: str, row: dict) -> list[tuple[str, str, str, bool]]:
    """Return the rows to print: figure, measured value, target or peer, target met."""
    if command == "efficiency":
        measured = row["efficiency"]
        return [
            (
                f"{row['workers']} workers busy",
                f"{measured:.1%}",
                f">= {MIN_EFFICIENCY:.0%}",
                measured >= MIN_EFFICIENCY,
            )
        ]
    if command == "starter":
        ratio = row["peer_s"] / row["own_s"]
        return [
            (
                "starter catalogue",
                f"{row['own_s']:.0f} s",
                f"dvc repro: {row['peer_s']:.0f} s, {ratio:.2f} times as long",
                True,
            )
        ]
    first, idle, changed = row["first"], row["idle"], row["changed"]
    per_stage = 1000 * first["seconds"] / first["ran"]
    seconds, megabytes = MAX_IDLE.get(row["objects"], (None, None))
    times = "dvc repro: none in a minute"
    if row["peer_stages"]:
        peer = 1000 * row["peer_s"] / row["peer_stages"]
        times = f"dvc repro, first {row['peer_stages']}: {peer:.0f}, {peer / per_stage:.1f} times"
    repro = f"over {IDLE_SECONDS:.0f}" if row["peer_idle_s"] is None else f"{row['peer_idle_s']:.0f}"
    return [
        (
            f"first build, per stage of {first['ran']}",
            f"{per_stage:.0f} ms",
            f"<= {MAX_OVERHEAD_MS:.0f}; {times}",
            per_stage <= MAX_OVERHEAD_MS,
        ),
        ("first build, engine", f"{first['cpu_s']:.0f} CPU s, {first['peak_mb']:.0f} MB", "", True),
        (
            f"nothing to do, {idle['stages']} stages",
            f"{idle['seconds']:.1f} s, {idle['peak_mb']:.0f} MB",
            (f"<= {seconds:.0f} s" if seconds else "")
            + (f", <= {megabytes:.0f} MB" if megabytes else "")
            + f"; dvc repro: {repro} s",
            (seconds is None or idle["seconds"] <= seconds)
            and (megabytes is None or idle["peak_mb"] <= megabytes),
        ),
        (
            "one changed material",
            f"{changed['ran']} stages, {changed['seconds']:.1f} s",
            f"{RERUN} stages",
            changed["ran"] == RERUN,
        ),
    ]


def show(command: str, row: dict, console: Console) -> list[str]:
    """Print a row and return what it misses."""
    title = f"{row['objects']} objects, {row['workers']} workers" if command == "scale" else command
    table = Table("", "measured", "target or peer", title=title, title_justify="left")
    shown = lines(command, row)
    for name, measured, target, met in shown:
        table.add_row(name, measured if met else f"[red]{measured}", target)
    console.print(table)
    return [
        f"{name}: {measured}, target {target.partition(';')[0]}"
        for name, measured, target, met in shown
        if not met
    ]


def main() -> None:
    run_job({"build": run_build})
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("command", choices=("scale", "efficiency", "starter"))
    parser.add_argument("--objects", type=int, nargs="+", default=[100], help="for scale")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--json", type=Path, help="file for the figures")
    arguments = parsed(parser)
    measure = {"scale": scale, "efficiency": efficiency, "starter": starter}[arguments.command]
    rows, missed = [], []
    for objects in arguments.objects if arguments.command == "scale" else [0]:
        with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as name:
            rows.append(measure(Path(name), arguments.workers, objects))
        missed += show(arguments.command, rows[-1], Console())
    write_record(arguments.json, {arguments.command: rows}, TARGETS[arguments.command], missed)
    sys.exit(bool(missed))


if __name__ == "__main__":
    main()
