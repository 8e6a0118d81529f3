"""dvc.yaml says exactly what the stages read."""

import ast
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest
from ruamel.yaml import YAML

from objectfolder.workspace import params
from objectfolder.workspace.check import check_all
from objectfolder.workspace.code_digests import imported_files
from objectfolder.workspace.layout import Benchmarks, Build, code_list

ROOT = Path(__file__).parents[2]
STAGES = YAML(typ="safe").load((ROOT / "dvc.yaml").read_text())["stages"]
HASH_CODE = STAGES.pop("hash_code")
OF_OBJECTS = (*params.OBJECT_STAGES, *params.ON_DEMAND)


@cache
def modules_of(stage):
    return imported_files(f"stages/{stage}.py", ROOT)


def modules(*stages):
    return {file for stage in stages for file in modules_of(stage)}


def test_every_stage_script_is_in_the_graph_and_the_reverse():
    assert {p.stem for p in (ROOT / "stages").glob("*.py")} - {"__init__", "hash_code"} == set(STAGES)


@pytest.mark.parametrize("stage", STAGES)
def test_every_stage_depends_on_its_own_code_and_declares_nothing_twice(stage):
    deps = STAGES[stage]["do"]["deps"]
    assert code_list(stage).as_posix() in deps
    assert len(deps) == len(set(deps))
    assert not [dep for dep in deps if dep.endswith(".py")]


def test_code_lists_are_made_from_all_sources():
    assert set(HASH_CODE["deps"]) == {"materials", "objectfolder", "stages"}
    assert HASH_CODE["outs"] == [code_list("any").parent.as_posix()]


def parameters_read(stage):
    """Return the parameters that a stage's script reads, as dvc.yaml names them.

    Scripts use ``params.<name>`` and ``params.entry.<field>``. They pass ``params`` whole only to a task,
    which reads its section and the seed.
    """
    tree = ast.parse((ROOT / "stages" / f"{stage}.py").read_text())
    parents = {child: node for node in ast.walk(tree) for child in ast.iter_child_nodes(node)}
    read = set()
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call) or getattr(node.func, "id", "") not in READERS:
            continue
        if node.func.id == "object_keys":
            read.add(KEYS_OF.get(node.args[0].value, "objects"))
            continue
        section = {place.rpartition(":")[2]: name for name, place in params.SECTIONS.items()}
        read |= {section[node.args[0].id]} | READERS[node.func.id]
        if isinstance(parents[node], ast.Attribute):  # stage_params(...).settings
            assert parents[node].attr == "settings"
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and node.id == "params" and isinstance(node.ctx, ast.Load):
            used = parents[node]
            if isinstance(used, ast.Call):
                assert stage in {*params.TASKS, *params.ROBOT_STAGES}
                read.add("seed")
            elif used.attr == "entry":
                read.add(f"objects.${{key}}.{parents[used].attr}")
            elif used.attr != "settings":
                read.add(used.attr)
    return read


READERS = {"stage_params": set(), "robot_params": set(), "task_params": {"encode"}, "object_keys": set()}
#: Where a task finds the names of its objects, if not under ``objects``.
KEYS_OF = {"grasp_stability": "benchmarks.grasp_data"}


@pytest.mark.parametrize("stage", sorted(set(STAGES) - {"generate"}))
def test_declared_params_are_the_ones_the_stage_reads(stage):
    declared = STAGES[stage]["do"].get("params", [])
    assert len(declared) == len(set(declared))
    assert parameters_read(stage) == set(declared)


def test_stage_names_are_those_of_the_graph():
    known = (*OF_OBJECTS, *params.TASKS, *params.ROBOT_STAGES)
    assert {*known, *params.FIRST_STAGES} == {*STAGES, "hash_code"}
    assert len(known) == len(set(known))


@pytest.mark.parametrize("task", params.TASKS)
def test_tasks_depend_on_all_observations(task):
    declared = STAGES[task]["do"]
    assert STAGES[task]["foreach"] == f"${{benchmarks.{task}}}"
    seen = Benchmarks().grasps if task == "grasp_stability" else Benchmarks().observations
    assert seen("any").parent.as_posix() in declared["deps"]
    assert STAGES["observe"]["do"]["outs"] == [Benchmarks().observations("${key}").as_posix()]
    assert STAGES["grasp_data"]["do"]["outs"] == [Benchmarks().grasps("${item}").as_posix()]


@pytest.mark.parametrize("stage", params.ROBOT_STAGES)
def test_stages_of_robots_depend_on_the_hulls(stage):
    declared = STAGES[stage]["do"]
    assert STAGES[stage]["foreach"] == f"${{benchmarks.{stage}}}"
    hulls = Build("${item}").hulls.as_posix()
    assert hulls in (declared["outs"] if stage == "decompose" else declared["deps"])


#: Most modules of the project that a stage may import: editing any of them reruns the stage for every object.
MAX_MODULES = {
    "generate": 53,
    "normalize": 47,
    "voxelize": 49,
    "modal": 47,
    "radiation": 33,
    "render_views": 46,
    "render_touch": 38,
    "train_vision": 66,
    "train_audio": 32,
    "train_touch": 48,
    "pack": 16,
    "evaluate": 106,
    "observe": 108,
    "recognize": 37,
    "retrieve": 36,
    "reconstruct": 129,
    "decompose": 102,
    "grasp_data": 119,
    "grasp_stability": 33,
    "grasp_policy": 135,
    "reach": 127,
}


def test_stages_import_few_modules():
    counts = {stage: len(modules(stage)) for stage in STAGES}
    print(*(f"{stage:16}{count:4}" for stage, count in counts.items()), sep="\n")
    assert counts.keys() == MAX_MODULES.keys()
    assert {stage: n for stage, n in counts.items() if n > MAX_MODULES[stage]} == {}


def test_stages_without_nets_start_without_torch():
    """It takes longer to import than everything else that these stages use."""
    code = "import sys\n"
    for stage in ("generate", "normalize", "voxelize", "modal", "pack"):
        code += f"import stages.{stage}\nassert 'torch' not in sys.modules, '{stage}'\n"
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize("stage", sorted({*OF_OBJECTS, "generate"} - {"pack", "evaluate", "observe"}))
def test_queries_may_change_without_rebuilding(stage):
    senses = {f"objectfolder/objectfile/{name}.py" for name in ("file", "parts", "vision", "audio", "touch")}
    assert not senses & modules(stage)


@pytest.mark.parametrize("stage", STAGES)
def test_the_command_line_and_the_engine_may_change_without_rebuilding(stage):
    folders = {"/".join(file.split("/")[:2]) for file in modules(stage)}
    assert not {"objectfolder/cli", "objectfolder/engine"} & folders


def test_lanes_do_not_depend_on_each_other():
    def folders(*stages):
        return {file.split("/")[1] for file in modules(*stages)}

    assert "vision" not in folders("modal", "train_audio", "render_touch")
    assert "touch" not in folders("modal", "render_views", "train_vision")
    assert "fem" not in folders("render_views", "render_touch", "train_audio")


def test_command_takes_one_word_only():
    for name, stage in STAGES.items():
        word = "item" if name in {*params.TASKS, *params.ROBOT_STAGES} else "key"
        assert stage["do"]["cmd"] == f"python -m stages.{name} ${{{word}}}"


def test_outputs_are_disjoint_and_inside_the_workspace():
    kinds = ("outs", "metrics", "plots")
    given = [out for stage in STAGES.values() for kind in kinds for out in stage["do"].get(kind, [])]
    outs = [next(iter(out)) if isinstance(out, dict) else out for out in given]
    assert len(outs) == len(set(outs))
    homes = ("build/${key}/", "build/${item}/", "data/objects/${key}", "metrics/${key}", "benchmarks/")
    assert all(out.startswith(homes) for out in outs)


@pytest.mark.parametrize("preset", ["quick", "laptop", "standard", "faithful", "faithful-small"])
def test_presets_are_complete_and_valid(preset):
    values = params.read(ROOT / "params.yaml")
    sections = YAML(typ="safe").load((ROOT / "params" / f"{preset}.yaml").read_text())
    assert set(sections) == {"sensor", *params.SECTIONS}
    check_all({**values, **sections})


def test_params_yaml_holds_the_starter_catalogue_at_preset_quick():
    values = params.read(ROOT / "params.yaml")
    starter = params.read(ROOT / "catalogs" / "starter.yaml")
    assert {k: values["objects"][k] for k in starter["objects"]} == starter["objects"]
    assert {k: values["procedural"][k] for k in starter["procedural"]} == starter["procedural"]
    quick = YAML(typ="safe").load((ROOT / "params" / "quick.yaml").read_text())
    assert {k: values[k] for k in quick} == quick
