"""Stages that targets mean, in the graph of the real dvc.yaml."""

import shutil
from pathlib import Path

import pytest
from dvc.repo import Repo
from ruamel.yaml import YAML

from objectfolder.engine.dvc.graph import stage_graph
from objectfolder.engine.dvc.repository import open_repository
from objectfolder.workspace.stages import OBJECT_STAGES

ROOT = Path(__file__).parents[3]
KEYS = ("mug", "die", "bell")


@pytest.fixture(scope="module")
def addresses(tmp_path_factory):
    """Return a function from targets and benchmarks to the addresses of the graph."""
    root = tmp_path_factory.mktemp("starters")
    Repo.init(str(root), no_scm=True).close()
    shutil.copy(ROOT / "dvc.yaml", root)
    values = YAML(typ="safe").load((ROOT / "params.yaml").read_text())

    def collect(*targets, **benchmarks):
        with (root / "params.yaml").open("w") as stream:
            YAML().dump(values | {"benchmarks": values["benchmarks"] | benchmarks}, stream)
        with open_repository(root) as repository:
            return set(stage_graph(repository, targets).stages)

    return collect


def of_objects(*keys):
    stages = ("generate", *OBJECT_STAGES)
    return {"hash_code", *(f"{stage}@{key}" for stage in stages for key in keys)}


def observed(*keys):
    return {f"observe@{key}" for key in keys}


def test_a_build_observes_no_object(addresses):
    assert addresses() == of_objects(*KEYS)
    assert addresses("mug") == of_objects("mug")
    assert addresses("mug", decompose=["mug"]) == of_objects("mug") | {"decompose@mug"}


@pytest.mark.parametrize("task", ["recognize", "retrieve", "reconstruct"])
def test_a_task_observes_all_objects(addresses, task):
    wanted = {f"{task}@seen", *observed(*KEYS)}
    assert addresses(**{task: ["seen"]}) == of_objects(*KEYS) | wanted
    unused = {f"evaluate@{key}" for key in KEYS}
    assert addresses(task, **{task: ["seen"]}) == (of_objects(*KEYS) | wanted) - unused


@pytest.mark.parametrize(
    ("target", "keys"),
    [("observe", KEYS), ("observe@mug", ["mug"]), ("benchmarks/observations/mug", ["mug"])],
)
def test_a_target_observes_what_it_names(addresses, target, keys):
    unused = {f"evaluate@{key}" for key in keys}
    assert addresses(target) == (of_objects(*keys) | observed(*keys)) - unused
