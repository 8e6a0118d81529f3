"""Tables of docs/results.md about robots; `perf/results.py` puts them there."""

from pathlib import Path

from objectfolder.benchmarks.layout import Benchmarks
from objectfolder.benchmarks.params import splits_of
from objectfolder.benchmarks.scoring import tables
from objectfolder.io import read_json
from objectfolder.workspace.presets import read_preset

#: Tasks with one object: the command, the layout of its table, the section of parameters, and the policy that
#: every seed has trained.
OF_ONE = {
    "grasp_policy": ("grasping", tables.grasping_table, "grasp_policy", "touch"),
    "reach": ("reach", tables.reach_table, "reach", "ppo"),
    "metaworld_reach": ("reach --metaworld", tables.reach_table, "reach", "ppo"),
}


def robot_tables(root: Path) -> list[str]:
    """Tables of what `objectfolder bench` has left in the folders of presets."""
    lines: list[str] = []
    for preset in ("quick", "standard", "paper"):
        folder, sections = Benchmarks(root / preset), read_preset(preset, root.parent)[0]
        for split in splits_of("grasp_stability"):
            if folder.result("grasp_stability", split).is_file():
                scores = read_json(folder.result("grasp_stability", split))
                found = next(iter(scores["sizes"].values()))
                command = f"stability --preset {preset} --split {split}"
                command += _seeds(found["V"], sections["grasp_stability"])
                took = [read_json(folder.machine("grasp_stability", split))]
                lines += laid_out(tables.table("grasp_stability", split, scores), command, took)
                lines.append(f"\nObjects: {', '.join(scores['keys'])}.")
        for task, (command, layout, section, policy) in OF_ONE.items():
            ran = [path.stem.removeprefix(f"{task}_") for path in sorted(folder.dir.glob(f"{task}_*.csv"))]
            keys = [key for key in ran if folder.machine(task, key).is_file()]
            if keys:
                took = [read_json(folder.machine(task, key)) for key in keys]
                scores = {key: read_json(folder.result(task, key)) for key in keys}
                seeds = _seeds(scores[keys[0]][policy], sections[section])
                files = " ".join(f"build/{key}" for key in keys)
                lines += laid_out(layout(scores), f"{command} --preset {preset}{seeds} {files}", took)
    return lines


def _seeds(score: dict, preset: dict) -> str:
    """Option of the command whose number of seeds is not the preset's."""
    count = len(score["seeds"])
    return "" if count == preset["seeds"] else f" --seeds {count}"


def laid_out(shown: tables.Table, command: str, took: list[dict]) -> list[str]:
    """Table under the command that prints it, and what that took."""
    first, cpu = took[0], sum(run["cpu_seconds"] for run in took) / 60
    minutes = " + ".join(f"{run['seconds'] / 60:.0f}" for run in took)
    return [
        f"\n### {shown.title}\n",
        f"`objectfolder bench {command}`: {minutes} minutes with {first['threads']} thread(s), "
        f"{cpu:.0f} of CPU; {first['machine']}.\n",
        shown.markdown(),
    ]


def labels(figures: dict) -> list[str]:
    """Table of what `perf/grasp.py labels` has measured."""
    rows = figures["rows"]
    steps = sorted({row["timestep_ms"] for row in rows})
    by = {(row["setting"], row["timestep_ms"]): row for row in rows}
    lines = [
        "\n### Do labels of grasps depend on the time step?\n",
        f"`python perf/grasp.py labels FILE ... --json build/perf/grasp_labels.json`: {rows[0]['trials']} "
        f"grasps of {', '.join(rows[0]['by_object'])}, of which half succeed. Share that ends as with a time "
        f"step of 0.25 ms, %; in brackets grasps per CPU second; {figures['machine']}.\n",
        f"| contacts | {' | '.join(f'{step:g} ms' for step in steps)} |",
        "|---" * (1 + len(steps)) + "|",
    ]
    for setting in dict.fromkeys(row["setting"] for row in rows):
        cells = [by[setting, step] for step in steps]
        shown = (f"{100 * cell['agreement']:.1f} ({cell['trials_per_cpu_second']:.0f})" for cell in cells)
        lines.append(f"| {setting} | {' | '.join(shown)} |")
    return lines


def grasps_per_second(figures: dict) -> list[str]:
    """Table of what `perf/grasp.py speed` has measured."""
    lines = [
        "\n### Grasps per second\n",
        "`python perf/grasp.py speed FILE ... --json build/perf/grasp_speed.json`: labelled grasps, each "
        f"repeated twice with small changes, two threads; {figures['machine']}. Targets: 15 and 5.\n",
        "| object | hulls | labels alone | with pictures and touches |",
        "|---|---|---|---|",
    ]
    return lines + [
        f"| {row['object']} | {row['hulls']} | {row['labels']:.1f} | {row['pictures and touches']:.1f} |"
        for row in figures["rows"]
    ]
