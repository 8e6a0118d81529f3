"""Each parameter alone, changed and changed back: with the real dvc.yaml, and stand-ins for the stages.

A stand-in writes a digest of what dvc.yaml declares that its stage reads; tests/pipeline/test_declarations.py
checks that the stages read no more.
"""

import hashlib
import inspect
import json
from collections import Counter
from pathlib import Path

from hypothesis import settings
from ruamel.yaml import YAML

from objectfolder.base.io import write_text
from objectfolder.engine.build import BuildOptions, build
from objectfolder.engine.summary import StageOutcome
from objectfolder.workspace.code_digests import code_text
from objectfolder.workspace.layout import MATERIALS, code_list
from objectfolder.workspace.stages import OBJECT_TASKS, TASKS

from . import tiny_project
from .tiny_project import ROOT, changed, parameters, start

#: All of them by `make fuzz`; else a few of each kind.
STRIDE = 1 if settings.get_current_profile_name() == "fuzz" else 97
PIPELINE = YAML(typ="safe").load((ROOT / "dvc.yaml").read_text())["stages"]
BENCHMARKS = {
    **{task: ["seen"] for task in TASKS},
    **{stage: ["bell", "mug"] for stage in ("decompose", "grasp_data")},
    **{stage: ["mug"] for stage in OBJECT_TASKS},
}


def stand_in(stage, key, params, pipeline, root):
    """Write what a stage declares as outputs, a digest of what it declares as inputs; return their names."""
    spec = pipeline[stage].get("do", pipeline[stage])

    def filled(name):
        return name.replace("${key}", key).replace("${item}", key).replace("${sensor}", params["sensor"])

    read = [stage, key]
    for name in map(filled, spec["deps"]):
        top = Path(root, name)
        files = sorted(path for path in top.rglob("*") if path.is_file()) if top.is_dir() else [top]
        read += [(path.relative_to(root).as_posix(), path.read_text()) for path in files]
    for name in map(filled, spec.get("params", ())):
        value = params
        for part in name.split("."):
            value = value[part]
        read.append((name, value))
    text = hashlib.sha256(json.dumps(read, sort_keys=True).encode()).hexdigest()
    written = []
    needed = {dep for other in pipeline.values() for dep in other.get("do", other)["deps"]}
    for out in (out for kind in ("outs", "metrics", "plots") for out in spec.get(kind, ())):
        out = out if isinstance(out, str) else next(iter(out))
        inside = [dep for dep in needed if dep.startswith(f"{out}/")]
        names = [out] if Path(out).suffix else inside or [f"{out}/data.txt"]
        for name in map(filled, names):
            Path(root, name).parent.mkdir(parents=True, exist_ok=True)
            Path(root, name).write_text(f"{json.dumps(text)}\n")
            written.append(name)
    return written


COMMON = f"""
import hashlib, json, os, sys
from pathlib import Path

PIPELINE = json.loads({json.dumps(PIPELINE)!r})

{inspect.getsource(stand_in)}

def run(stage):
    params = Path(os.environ.get("OBJECTFOLDER_PARAMS", "params.yaml"))
    stand_in(stage, sys.argv[1], json.loads(params.read_text()), PIPELINE, ".")
"""
TEXTS = {f"stages/{stage}.py": f"from stages import run\nrun({stage!r})\n" for stage in PIPELINE}
TEXTS |= {
    "stages/__init__.py": COMMON,
    "data/objects/bell/mesh.obj": "mesh",
    "dvc.yaml": (ROOT / "dvc.yaml").read_text(),
    "objectfolder/stored/objectfile.schema.json": "{}",
    "objectfolder/benchmarks/data/objects.csv": "bell",
    f"{MATERIALS}/README.md": "own materials",
    **{
        f"objectfolder/base/{MATERIALS}/{path.name}": path.read_text()
        for path in (ROOT / "objectfolder/base" / MATERIALS).glob("*.yaml")
    },
    **{f"objectfolder/touch/profiles/{name}.yaml": name for name in tiny_project.PROFILES},
}


def write_truth(params, root):
    """Write what a build from nothing gives, by calls of the stand-ins in order; return files by stage."""
    for name, text in TEXTS.items():
        write_text(root / name, text)
    write_text(root / "params.yaml", json.dumps(params))
    names = [*(PIPELINE.keys() - {"hash_code"}), *(f"{MATERIALS}/{key}" for key in params["objects"])]
    lists = {name: code_list(name).as_posix() for name in names}
    for name, path in lists.items():
        write_text(root / path, code_text(name, root) or "")
    written = {"hash_code": list(lists.values())}
    for stage, spec in PIPELINE.items():
        keys = params
        for part in spec.get("foreach", "").strip("${}").split("."):
            keys = keys.get(part, ())
        written |= {f"{stage}@{key}": stand_in(stage, key, params, PIPELINE, root) for key in keys}
    return written


def test_each_parameter_changed_and_changed_back_is_never_stale(tmp_path):
    base = start() | {"benchmarks": BENCHMARKS}
    workspace, truth = tmp_path / "workspace", tmp_path / "truth"
    tiny_project.make_workspace(workspace, TEXTS | {"params.yaml": json.dumps(base)})
    counts: Counter[str] = Counter()

    def check(params, targets):
        """Build; return what ran."""
        (workspace / "params.yaml").write_text(json.dumps(params))
        summary = build(targets, BuildOptions(jobs=2), workspace)
        assert summary.ok, summary.failures
        files = write_truth(params, truth)
        for address in summary.stages.keys() - {"data/objects/bell.dvc"}:
            for name in files[address]:
                assert (workspace / name).read_bytes() == (truth / name).read_bytes(), (address, name)
        counts.update(str(one.status) for one in summary.stages.values())
        return summary.with_status(StageOutcome.RAN)

    check(base, ())
    wanted = {path: values for path, values in parameters().items() if path[0] != "benchmarks"}
    for path, (first, *others) in list(wanted.items())[::STRIDE]:
        # Of a generator, many: without the stages downstream, which see a file as any other.
        place, targets = (path[:2], ["normalize@mug"]) if path[0] == "procedural" else (path, ())
        if targets:
            check(changed(base, place, first), targets)
        for value in others:
            ran = check(changed(base, place, value), targets)
            assert ran, f"no stage reads {path}"
            assert not check(changed(base, place, first), targets)
        counts["parameters"] += 1
    print(dict(counts))
