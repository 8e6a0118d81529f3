import json
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path

import pytest
from refusals import refused

from objectfolder.benchmarks.tasks.grasp_stability import GraspStabilityConfig
from objectfolder.benchmarks.tasks.task import find_task
from objectfolder.workspace.check import check_all
from objectfolder.workspace.params import read, settings
from objectfolder.workspace.stages import BENCHMARKS, check_key, section_config

ROOT = Path(__file__).parents[2]


@pytest.fixture
def values():
    return read(ROOT / "params.yaml")


def as_yaml(settings):
    return json.loads(json.dumps(asdict(settings)))


@pytest.mark.parametrize("name", BENCHMARKS)
def test_a_task_is_what_its_declaration_says_everywhere(values, name):
    task = find_task(name)
    assert (task.name, task.splits) == (name, BENCHMARKS[name])
    assert task.settings is section_config(name)
    assert task.load().__module__ == f"objectfolder.benchmarks.tasks.{name}_training"
    guide, protocols = ((ROOT / f"docs/{page}.md").read_text() for page in ("benchmarks", "protocols"))
    assert f"`bench {name.replace('_', '-')}`" in guide
    assert f"## {task.page}\n" in guide + protocols
    params = task.params(values)
    assert params.settings == settings(task.settings, values)
    assert params.seed == values["seed"]
    if task.trains_nets:
        assert as_yaml(params.encode) == values["encode"]
    refused("name of a stage", check_key, name)


def test_declarations_are_read_without_torch():
    """A command that shows its help needs no libraries of training."""
    code = "import sys, objectfolder.cli; assert not {'torch', 'mujoco', 'gymnasium'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"retrieve": None}, "retrieve"),
        ({"recognize": {"seeds": 0}}, "recognize: seeds"),
        ({"encode": {"image": 4}}, "encode: image"),
        ({"encode": {"touch": [40]}}, "encode: touch"),
        ({"encode": {"precision": "float16"}}, "encode: precision"),
        ({"recognize": {"label_smoothing": 1.0}}, "recognize: label_smoothing"),
        ({"reconstruct": {"wide": 3}}, "reconstruct: wide"),
        ({"benchmarks": {"retrieve": ["sen"]}}, "benchmarks: retrieve.0"),
        ({"benchmarks": {"recognize": ["unseen"]}}, "benchmarks: recognize.0"),
    ],
)
def test_wrong_values_are_named(values, change, message):
    for section, fields in change.items():
        values[section] = None if fields is None else {**values[section], **fields}
    refused(f"params.yaml: {message}", check_all, values)


@pytest.mark.parametrize("section", ["encode", "recognize", "benchmarks"])
def test_lacking_sections_say_what_to_do(values, section):
    del values[section]
    refused(r"lacks .*(preset quick|add `benchmarks: \{recognize: \[\])", check_all, values)


@pytest.mark.parametrize("sizes", [[], [1, 100], [1000, 100], [100, 100]])
def test_sizes_ascend(values, sizes):
    assert settings(GraspStabilityConfig, values).sizes == tuple(values["grasp_stability"]["sizes"])
    values["grasp_stability"]["sizes"] = sizes
    refused(r"params.yaml: grasp_stability: sizes", settings, GraspStabilityConfig, values)
