"""dvc.yaml says exactly what the stages read."""

from pathlib import Path

import pytest
from closure import imported_files
from ruamel.yaml import YAML

from objectfolder import params

ROOT = Path(__file__).parents[2]
STAGES = YAML(typ="safe").load((ROOT / "dvc.yaml").read_text())["stages"]


def test_every_stage_script_is_in_the_graph_and_the_reverse():
    assert {p.stem for p in (ROOT / "stages").glob("*.py")} - {"__init__"} == set(STAGES)


@pytest.mark.parametrize("stage", STAGES)
def test_declared_modules_are_the_imported_ones(stage):
    deps = STAGES[stage]["do"]["deps"]
    declared = {d for d in deps if d.endswith(".py")}
    assert declared == imported_files(ROOT / "stages" / f"{stage}.py", ROOT)
    assert len(deps) == len(set(deps))


@pytest.mark.parametrize("stage", sorted(set(STAGES) - {"generate"}))
def test_declared_params_are_the_ones_the_stage_gets(stage):
    fields = {f"objects.${{key}}.{field}" for field in params.OBJECT_FIELDS[stage]}
    section = {stage} & set(params.SECTIONS)
    declared = STAGES[stage]["do"].get("params", [])
    assert set(declared) == fields | set(params.SHARED.get(stage, ())) | section
    got = params.stage_params(stage, "mug", ROOT / "params.yaml")
    assert set(vars(got.object)) == set(params.OBJECT_FIELDS[stage])
    assert set(vars(got)) == {"object", "section", *params.SHARED.get(stage, ())}


@pytest.mark.parametrize("stage", sorted(set(STAGES) - {"pack", "evaluate"}))
def test_queries_may_change_without_rebuilding(stage):
    deps = STAGES[stage]["do"]["deps"]
    assert not {"objectfolder/query.py", "objectfolder/objectfile.py", "objectfolder/cli.py"} & set(deps)


def test_lanes_do_not_depend_on_each_other():
    def modules(stage):
        return " ".join(STAGES[stage]["do"]["deps"])

    assert "vision/" not in modules("modal") + modules("train_audio") + modules("render_touch")
    assert "touch/" not in modules("modal") + modules("render_views") + modules("train_vision")
    assert "fem/" not in modules("render_views") + modules("render_touch") + modules("train_audio")


def test_command_takes_the_object_key_only():
    assert all(s["do"]["cmd"] == f"python -m stages.{name} ${{key}}" for name, s in STAGES.items())


def test_outputs_are_disjoint_and_inside_the_workspace():
    outs = [o for s in STAGES.values() for o in s["do"].get("outs", []) + s["do"].get("metrics", [])]
    assert len(outs) == len(set(outs))
    assert all(o.startswith(("build/${key}/", "data/objects/${key}", "metrics/${key}")) for o in outs)


@pytest.mark.parametrize("preset", ["quick", "standard", "paper"])
def test_presets_are_complete_and_valid(preset):
    values = params.read(ROOT / "params.yaml")
    sections = YAML(typ="safe").load((ROOT / "params" / f"{preset}.yaml").read_text())
    assert set(sections) == set(params.SECTIONS)
    params.check_all({**values, **sections})


def test_params_yaml_holds_the_starter_catalogue_at_preset_quick():
    values = params.read(ROOT / "params.yaml")
    starter = params.read(ROOT / "catalogs" / "starter.yaml")
    assert {k: values["objects"][k] for k in starter["objects"]} == starter["objects"]
    assert {k: values["procedural"][k] for k in starter["procedural"]} == starter["procedural"]
    quick = YAML(typ="safe").load((ROOT / "params" / "quick.yaml").read_text())
    assert {k: values[k] for k in quick} == quick
