"""dvc.yaml says exactly what the stages read."""

import ast
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest
from ruamel.yaml import YAML

from objectfolder.benchmarks.tasks.task import find_task
from objectfolder.workspace import params, stages
from objectfolder.workspace.check import check_all
from objectfolder.workspace.code_digests import imported_files
from objectfolder.workspace.layout import Benchmarks, Build, code_list
from objectfolder.workspace.presets import default_sections, read_preset

ROOT = Path(__file__).parents[2]
STAGES = YAML(typ="safe").load((ROOT / "dvc.yaml").read_text())["stages"]
HASH_CODE = STAGES.pop("hash_code")
OF_OBJECTS = (*stages.OBJECT_STAGES, *stages.ON_DEMAND)


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
    """Return the parameters that a stage reads, as dvc.yaml names them.

    Scripts of objects use ``params.<name>``, ``params.entry.<field>`` or ``object_entry``; tasks declare
    what they read.
    """
    if stage in stages.BENCHMARKS:
        task = find_task(stage)
        read = {stage, "seed"} | ({"encode"} if task.trains_nets else set())
        if task.splits:
            read.add("benchmarks.grasp_data" if task.samples == "grasps" else "objects")
        return read
    tree = ast.parse((ROOT / "stages" / f"{stage}.py").read_text())
    parents = {child: node for node in ast.walk(tree) for child in ast.iter_child_nodes(node)}
    read = set()
    for node in ast.walk(tree):
        called = getattr(node.func, "id", "") if isinstance(node, ast.Call) else ""
        if called == "object_entry":  # a field that may be absent, which DVC would not see alone
            read.add("objects.${key}")
        if called != "stage_params":
            continue
        section = {place.rpartition(":")[2]: name for name, place in stages.SECTIONS.items()}
        read.add(section[node.args[0].id])
        if isinstance(parents[node], ast.Attribute):  # stage_params(...).settings
            assert parents[node].attr == "settings"
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and node.id == "params" and isinstance(node.ctx, ast.Load):
            used = parents[node]
            if used.attr == "entry":
                read.add(f"objects.${{key}}.{parents[used].attr}")
            elif used.attr != "settings":
                read.add(used.attr)
    return {PARTS_OF_SECTIONS.get((stage, name), name) for name in read}


#: Stages that read one setting of a section of another stage.
PARTS_OF_SECTIONS = {
    ("close_ups", "encode"): "encode.touch",
    ("close_ups", "vision_to_touch"): "vision_to_touch.contacts",
}


@pytest.mark.parametrize("stage", sorted(set(STAGES) - {"generate"}))
def test_declared_params_are_the_ones_the_stage_reads(stage):
    declared = STAGES[stage]["do"].get("params", [])
    assert len(declared) == len(set(declared))
    assert parameters_read(stage) == set(declared)


def test_stage_names_are_those_of_the_graph():
    known = {*OF_OBJECTS, *stages.BENCHMARKS, *stages.ROBOT_STAGES}
    assert {*known, *stages.FIRST_STAGES} == {*STAGES, "hash_code"}


@pytest.mark.parametrize("name", stages.BENCHMARKS)
def test_tasks_depend_on_what_they_declare(name):
    task, declared = find_task(name), STAGES[name]["do"]
    assert STAGES[name]["foreach"] == f"${{benchmarks.{name}}}"
    assert f"{task.training.partition(':')[0].replace('.', '/')}.py" in modules(name)
    (plot,) = declared["plots"]
    ((curve, axes),) = plot.items()
    assert curve == Benchmarks().curve(name, "${item}").as_posix()
    assert set(axes.values()) <= set(task.columns)
    if task.samples is None:
        assert Build("${item}").object_file.as_posix() in declared["deps"]
    else:
        folder, stage, item = {
            "observations": (Benchmarks().observations, "observe", "${key}"),
            "close_ups": (Benchmarks().close_ups, "close_ups", "${key}"),
            "grasps": (Benchmarks().grasps, "grasp_data", "${item}"),
        }[task.samples]
        assert folder("any").parent.as_posix() in declared["deps"]
        assert STAGES[stage]["do"]["outs"] == [folder(item).as_posix()]


@pytest.mark.parametrize("stage", stages.ROBOT_STAGES)
def test_stages_of_robots_depend_on_the_hulls(stage):
    declared = STAGES[stage]["do"]
    assert STAGES[stage]["foreach"] == f"${{benchmarks.{stage}}}"
    hulls = Build("${item}").hulls.as_posix()
    assert hulls in (declared["outs"] if stage == "decompose" else declared["deps"])


#: Most modules of the project that a stage may import: editing any of them reruns the stage for every object.
MAX_MODULES = {
    **{"generate": 53, "normalize": 50, "voxelize": 49, "modal": 47, "radiation": 35, "render_views": 49},
    **{"render_touch": 38, "train_vision": 70, "train_audio": 31, "train_touch": 48, "pack": 20},
    **{"evaluate": 106, "observe": 106, "close_ups": 109, "decompose": 102, "grasp_data": 116},
    # Of benchmarks: those that ask for samples alone, and those that ask an object.
    **{"samples": 51, "objects": 132, "reconstruct": 126, "recognize": 124, "retrieve": 124},
}


def test_stages_import_few_modules():
    """Those of nets are not counted: a new kind may be added."""
    named = ("_net.py", "_training.py")
    counts = {stage: len([file for file in modules(stage) if not file.endswith(named)]) for stage in STAGES}
    print(*(f"{stage:16}{count:4}" for stage, count in counts.items()), sep="\n")
    kinds = {name: "samples" if splits else "objects" for name, splits in stages.BENCHMARKS.items()}
    most = {stage: MAX_MODULES.get(stage) or MAX_MODULES[kinds[stage]] for stage in STAGES}
    assert {stage: n for stage, n in counts.items() if n > most[stage]} == {}


def test_stages_without_nets_start_without_torch():
    """It takes longer to import than everything else that these stages use."""
    code = "import sys\n"
    for stage in ("generate", "normalize", "voxelize", "modal", "pack"):
        code += f"import stages.{stage}\nassert 'torch' not in sys.modules, '{stage}'\n"
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize("stage", sorted({*OF_OBJECTS, "generate"} - {"pack", "evaluate", *stages.ON_DEMAND}))
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
    assert not [file for file in modules("render_views", "render_touch", "train_audio") if "/fem/" in file]


def test_command_takes_one_word_only():
    for name, stage in STAGES.items():
        word = "item" if name in {*stages.BENCHMARKS, *stages.ROBOT_STAGES} else "key"
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
    sections, _ = read_preset(preset, ROOT)
    assert set(sections) == {"sensor", *stages.SECTIONS}
    check_all({**values, **sections})


def test_params_yaml_holds_the_starter_catalogue_at_preset_quick():
    values = params.read(ROOT / "params.yaml")
    starter = params.read(ROOT / "catalogs" / "starter.yaml")
    assert {k: values["objects"][k] for k in starter["objects"]} == starter["objects"]
    assert {k: values["procedural"][k] for k in starter["procedural"]} == starter["procedural"]
    quick = default_sections()
    assert {k: values[k] for k in quick} == quick  # and so every default is written there
