"""Senses: `python perf/senses.py [--speed] [--drop N] [--tap N] [--explore N FILE...] [--keep DIR]`.

``--speed``: real-time factors (simulated over CPU seconds, MuJoCo's steps included) of `Hearing` with 1, 10
and 30 mugs, dice and bells that fall on a table, at 48 kHz, in the second in which they land; and of
`Feeling` with 2 and 16 pads that squeeze a mug and shear the gel, at 30 pictures per second. One core, the
best of three runs.

``--drop N --keep DIR``: accuracy of the trained ear of ``ObjectFolder/Drop-v0`` on N / 4 unseen falls after
N others, beside chance. The oracle is right by definition: it reads ``info``. Falls are kept in DIR.

``--tap N --keep DIR``: how often, and after how many taps, the trained ear of ``ObjectFolder/Tap-v0`` finds
the odd one of `UNSEEN` rows after N others, beside random actions. `TRIED` more choose how sure it has to be.

``--explore N FILE...``: touches that the belief of ``ObjectFolder/Explore-v0`` needs to name objects in N
episodes, where it expects to learn most, and at random.

``--json FILE`` records the figures. Exits with 1 if a target is missed.
"""

import argparse
import copy
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from harness import exit_with_verdict, fresh, parsed, require, run_job, write_record
from rich.console import Console
from rich.table import Table

BODIES, PADS = (1, 10, 30), (2, 16)
#: Least real-time factors; for 30 bodies and 16 pads there is none.
TARGETS = {"bodies 1": 1.0, "bodies 10": 1.0, "pads 2": 1.0}
MATERIAL = 0.9  #: least share of materials told right
ODD = 0.9  #: least share of odd ones found
CERTAINTY = 0.99  #: probability at which an object is named
TOUCHES, FEWER = 0.5, 0.02  #: greatest ratio of touches to random's, and by how much fewer names are right
KINDS = ("mug", "die", "bell")
SECONDS = 1.0
REPEATS = 3  #: of each measurement of speed; the fastest counts, as others share the machine
TAPS = 3  #: of each object of a row to learn from
TRIED, UNSEEN = 100, 250  #: rows on which a threshold is chosen, and others


def hearing(bodies: str) -> dict:
    """Measure the second in which objects land, 0.2 s after they were let go."""
    import mujoco
    import numpy as np
    import torch

    from objectfolder import ObjectFile
    from objectfolder.sim.body import add_body, rigid_body
    from objectfolder.sim.hearing import Hearing

    torch.set_num_threads(1)
    files = [ObjectFile.sample(name) for name in KINDS]
    rigid = [rigid_body(file, [file.to_mesh().convex_hull]) for file in files]
    spec, objects, rng = mujoco.MjSpec(), {}, np.random.default_rng(0)
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[5, 5, 0.1])
    for k in range(int(bodies)):
        body = add_body(spec, rigid[k % 3], f"{k}")
        body.pos, turn = [0.3 * (k % 6), 0.3 * (k // 6), 0.4], rng.normal(size=4)
        body.quat = turn / np.linalg.norm(turn)
        objects[f"{k}"] = files[k % 3]
    model = spec.compile()
    ear, steps = Hearing(model, objects, [0.7, -0.8, 0.6]), round(SECONDS / model.opt.timestep)

    def land() -> tuple[float, int]:
        data, strikes = mujoco.MjData(model), 0
        ear.reset()
        ear.simulate(data, round(0.2 / model.opt.timestep))
        start = time.process_time()
        for _ in range(steps):
            ear.simulate(data)
            strikes += len(ear.strikes)
        return time.process_time() - start, strikes

    spent, strikes = min(land() for _ in range(REPEATS))
    return {"what": "bodies", "count": int(bodies), "factor": SECONDS / spent, "strikes": strikes}


def feeling(pads: str) -> dict:
    """Measure pads that squeeze mugs, two for each, which are pulled at."""
    import mujoco
    import torch

    from objectfolder import ObjectFile
    from objectfolder.sim.body import add_body, rigid_body
    from objectfolder.sim.feeling import Feeling

    torch.set_num_threads(1)
    file = ObjectFile.sample("mug")
    rigid = rigid_body(file, [file.to_mesh().convex_hull])
    spec, objects, names = mujoco.MjSpec(), {}, []
    spec.option.gravity = [0, 0, 0]
    for k in range(int(pads) // 2):
        x = 0.4 * k
        objects[f"{k}"] = file
        add_body(spec, rigid, f"{k}").pos = [x, 0, 0]
        for side in (1, -1):
            name = f"{k}_{side}"
            finger = spec.worldbody.add_body(name=name, pos=[x, side * 0.09, 0])
            finger.quat = [0.5**0.5, 0, 0, -side * 0.5**0.5]
            finger.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[1, 0, 0], damping=[20, 0, 0])
            finger.add_geom(
                type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.002, 0.01, 0.015], pos=[-0.002, 0, 0], mass=0.05,
                condim=4,
            )  # fmt: skip
            finger.add_site(name=name)
            names.append(name)
            spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    model = spec.compile()
    data, fingers = mujoco.MjData(model), Feeling(model, names, objects)
    data.ctrl[:] = 3.0
    mujoco.mj_step(model, data, 500)
    for name in objects:
        data.xfrc_applied[model.body(name).id, 2] = -1.0
    mujoco.mj_step(model, data, 100)
    fingers.feel(data)
    frames = 15

    def squeeze() -> tuple[float, int]:
        squeezed, touched = copy.copy(data), 0
        start = time.process_time()
        for _ in range(frames):
            mujoco.mj_step(model, squeezed, round(1 / 30 / model.opt.timestep))
            touched += int((fingers.feel(squeezed).touched > 0).sum())
        return time.process_time() - start, touched

    spent, touched = min(squeeze() for _ in range(REPEATS))
    return {"what": "pads", "count": int(pads), "factor": frames / 30 / spent, "touched": touched / frames}


def drop(first: str, count: str, path: str) -> dict:
    """Listen to falls and keep their sounds."""
    import numpy as np
    import torch

    from objectfolder.sim.drop import DropEnv

    torch.set_num_threads(1)
    env, sounds, answers = DropEnv(), [], []
    for seed in range(int(first), int(first) + int(count)):
        sound, info = env.reset(seed=seed)
        sounds.append(sound)
        answers.append([info["object"], info["material"]])
    np.savez(path, sounds=np.stack(sounds), answers=np.array(answers))
    return {"file": path}


def ear(folder: str, train: str) -> dict:
    """Train an ear on the first falls of a folder, and test it on the others."""
    import numpy as np
    import torch

    from objectfolder.sim.drop import DropEnv
    from objectfolder.sim.ears import Ear, features

    torch.set_num_threads(1)
    parts = [np.load(path, allow_pickle=False) for path in sorted(Path(folder).glob("*.npz"))]
    heard = np.concatenate([features(part["sounds"], 48000) for part in parts])
    answers = np.concatenate([part["answers"] for part in parts])
    env, known = DropEnv(), int(train)
    kinds = len(env.files), len(env.materials)
    net = Ear(heard[:known], answers[:known], kinds)
    found, right = net(heard[known:]), answers[known:]
    rng = np.random.default_rng(0)
    guessed = np.stack([rng.integers(kind, size=len(right)) for kind in kinds], 1)
    most = [np.bincount(answers[:known, k]).argmax() for k in (0, 1)]
    return {
        "falls": known,
        "unseen": len(right),
        "trained": (found == right).mean(0).tolist(),
        "random": (guessed == right).mean(0).tolist(),
        "commonest": (right == most).mean(0).tolist(),
        "materials": list(env.materials),
        "confused": [
            [int(((right[:, 1] == a) & (found[:, 1] == b)).sum()) for b in range(kinds[1])]
            for a in range(kinds[1])
        ],
    }


def rows(first: str, count: str, path: str) -> dict:
    """Tap all objects of rows, `TAPS` times each, and keep the features of the sounds."""
    import numpy as np
    import torch

    from objectfolder.sim.ears import features
    from objectfolder.sim.tap import TapEnv

    torch.set_num_threads(1)
    env, heard, odd, stuff = TapEnv(), [], [], []
    for seed in range(int(first), int(first) + int(count)):
        _, info = env.reset(seed=seed)
        taps = [[env.step(k)[0]["sound"] for _ in range(TAPS)] for k in range(env.count)]
        heard.append([features(np.stack(of), env.sample_rate) for of in taps])
        odd.append(info["odd"])
        places = np.arange(env.count) == info["odd"]
        stuff.append(np.where(places, info["other"], info["material"]))
    np.savez(path, heard=np.array(heard, np.float32), odd=np.array(odd), stuff=np.array(stuff))
    return {"file": path}


def tap(folder: str, train: str) -> dict:
    """Train an ear on the rows of a folder, and let it and others find the odd ones of other rows."""
    import numpy as np
    import torch

    from objectfolder.sim.ears import THRESHOLDS, OddEar, find_odd
    from objectfolder.sim.tap import TapEnv

    torch.set_num_threads(1)
    parts = [np.load(path, allow_pickle=False) for path in sorted(Path(folder).glob("*.npz"))]
    known = int(train)
    heard, odd, stuff = (
        np.concatenate([part[name] for part in parts])[:known] for name in ("heard", "odd", "stuff")
    )
    env, net = TapEnv(), OddEar(heard, odd, stuff)
    tried = {sure: [find_odd(env, net, sure, known + k) for k in range(TRIED)] for sure in THRESHOLDS}
    sure = max(tried, key=lambda one: np.mean([each["reward"] for each in tried[one]]))
    seeds = range(known + TRIED, known + TRIED + UNSEEN)
    played = {"trained": [find_odd(env, net, sure, seed) for seed in seeds], "random": [], "oracle": []}
    kinds: dict[str, list[bool]] = {}
    for seed, one in zip(seeds, played["trained"]):
        _, info = env.reset(seed=seed)
        pair = sorted(env.materials[info[name]] for name in ("material", "other"))
        kinds.setdefault(" and ".join(pair), []).append(one["right"])
        played["oracle"].append(finished(env, [env.count + info["odd"]]))
        env.reset(seed=seed)
        guesses = np.random.default_rng(seed).integers(2 * env.count, size=env.limit)
        played["random"].append(finished(env, guesses.tolist()))
    names = ("right", "taps", "reward")
    return {
        "rows": known,
        "unseen": len(seeds),
        "sure": sure,
        **{
            who: {name: float(np.mean([one[name] for one in of])) for name in names}
            for who, of in played.items()
        },
        "pairs": [{"pair": pair, "rows": len(of), "right": sum(of)} for pair, of in sorted(kinds.items())],
    }


def touches(count: str, *files: str) -> dict:
    """Learn to name objects by touch, and name them on episodes that were not learnt from."""
    import numpy as np
    import torch

    from objectfolder import ObjectFile
    from objectfolder.sim.explore import ExploreEnv, Explorer, explore

    torch.set_num_threads(1)
    env = ExploreEnv([ObjectFile.load(file) for file in files] or KINDS)
    explorer = Explorer(env)
    found = {}
    for who in ("trained", "random"):
        played = [explore(env, explorer, CERTAINTY, seed, who == "random") for seed in range(int(count))]
        found[who] = {
            **{
                name: float(np.mean([one[name] for one in played])) for name in ("right", "touches", "reward")
            },
            "most": max(one["touches"] for one in played),
        }
    return {
        "objects": [file.key for file in env.files],
        "episodes": int(count),
        "sure": CERTAINTY,
        "widths": list(explorer.widths),
        **found,
        "oracle": {"right": 1.0, "touches": 0.0, "reward": 1.0, "most": 0},
        "ratio": found["trained"]["touches"] / found["random"]["touches"],
    }


def finished(env: Any, actions: Iterable[int]) -> dict:
    """Play an episode of Tap-v0 that was reset."""
    taps = reward = 0
    for action in actions:
        _, earned, ended, cut, _ = env.step(action)
        taps, reward = taps + (action < env.count), reward + earned
        if ended or cut:
            break
    return {"right": earned > 0, "taps": taps, "reward": reward}


def kept(folder: Path, job: str, total: int, part: int = 100) -> Path:
    """Run a job that writes files of a folder, of some episodes each, unless they are there."""
    folder.mkdir(parents=True, exist_ok=True)
    for first in range(0, total, part):
        path = folder / f"{first:06d}.npz"
        if not path.exists():
            require(fresh(__file__, job, first, min(part, total - first), path))
    return folder


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--speed", action="store_true", help="measure real-time factors")
    parser.add_argument("--drop", type=int, default=0, metavar="N", help="train on N falls")
    parser.add_argument("--tap", type=int, default=0, metavar="N", help="train on N rows")
    parser.add_argument("--explore", type=int, default=0, metavar="N", help="name objects by touch N times")
    parser.add_argument("files", nargs="*", type=Path, help="Object Files to explore; default: the samples")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="folder for what is trained on")
    parser.add_argument("--json", type=Path, metavar="FILE", help="record the figures")
    given = parsed(parser)
    record, missed, console = {}, [], Console()
    if given.speed:
        table = Table("", "real-time factor", "target")
        record["speed"] = []
        for job, counts in (("hearing", BODIES), ("feeling", PADS)):
            for count in counts:
                row = require(fresh(__file__, job, count))
                name = f"{row['what']} {count}"
                target = TARGETS.get(name)
                table.add_row(name, f"{row['factor']:.2f}", "" if target is None else f"{target:g}")
                if target is not None and row["factor"] < target:
                    missed.append(f"{name}: {row['factor']:.2f} times real time, target {target:g}")
                record["speed"].append(row)
        console.print(table)
    if given.drop + given.tap and given.keep is None:
        parser.error("--drop and --tap need --keep DIR, where what they train on goes")
    if given.drop:
        folder = kept(given.keep / "falls", "drop", given.drop + given.drop // 4)
        row = require(fresh(__file__, "ear", folder, given.drop))
        table = Table("", "object", "material")
        for name in ("trained", "random", "commonest"):
            table.add_row(name, *(f"{share:.3f}" for share in row[name]))
        console.print(table, f"after {row['falls']} falls, on {row['unseen']} others; oracle 1, 1")
        if row["trained"][1] < MATERIAL:
            missed.append(f"materials by ear: {row['trained'][1]:.3f}, target {MATERIAL:g}")
        record["drop"] = row
    if given.tap:
        row = require(fresh(__file__, "tap", kept(given.keep / "rows", "rows", given.tap), given.tap))
        table = Table("", "right", "taps", "reward")
        for name in ("trained", "random", "oracle"):
            table.add_row(name, *(f"{row[name][of]:.3f}" for of in ("right", "taps", "reward")))
        console.print(table, f"after {row['rows']} rows, on {row['unseen']} others")
        if row["trained"]["right"] < ODD:
            missed.append(f"odd ones by tapping: {row['trained']['right']:.3f}, target {ODD:g}")
        record["tap"] = row
    if given.explore:
        row = require(fresh(__file__, "touches", given.explore, *given.files))
        table = Table("", "right", "touches", "reward")
        for name in ("trained", "random", "oracle"):
            table.add_row(name, *(f"{row[name][of]:.3f}" for of in ("right", "touches", "reward")))
        console.print(table, f"{row['episodes']} episodes, {len(row['objects'])} objects")
        if row["ratio"] > TOUCHES:
            missed.append(f"touches over those of random: {row['ratio']:.2f}, target {TOUCHES:g}")
        if row["trained"]["right"] < row["random"]["right"] - FEWER:
            missed.append(f"names right: {row['trained']['right']:.3f}, random {row['random']['right']:.3f}")
        record["explore"] = row
    aims = {
        "speed": "real time for 1 and 10 bodies at 48 kHz and for 2 pads at 30 Hz",
        "drop": f"{MATERIAL:.0%} of materials by ear",
        "tap": f"{ODD:.0%} of odd ones found",
        "explore": f"at most {TOUCHES:g} times random's touches, for as many right names within {FEWER:.0%}",
    }
    targets = "; ".join(aims[name] for name in record)
    write_record(given.json, record, targets, missed)
    exit_with_verdict(missed, console)


if __name__ == "__main__":
    run_job(
        {
            "hearing": hearing,
            "feeling": feeling,
            "drop": drop,
            "ear": ear,
            "rows": rows,
            "tap": tap,
            "touches": touches,
        }
    )
    main()
