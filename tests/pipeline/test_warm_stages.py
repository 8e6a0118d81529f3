"""Real stages that start as forks."""

import os
import shutil

import pytest

from objectfolder.engine.process import Children, Command, stage_environment
from objectfolder.engine.warm import Starter
from objectfolder.workspace.stages import FIRST_STAGES, OBJECT_STAGES, ON_DEMAND

pytestmark = pytest.mark.xdist_group("pipeline")


def command(root, *words):
    return Command(["python -m " + " ".join(words)], root, stage_environment(os.environ), root / "log")


@pytest.fixture(scope="module")
def starter():
    starter = Starter(stage_environment(os.environ))
    yield starter
    starter.close()


@pytest.mark.parametrize("stage", ["normalize", pytest.param("train_audio", marks=pytest.mark.slow)])
def test_a_stage_writes_the_same_bytes_as_in_a_new_python(built, starter, stage, tmp_path):
    written = []
    for name, how in (("warm", {"start": starter.start}), ("cold", {})):
        root = shutil.copytree(built.root, tmp_path / name, symlinks=True)
        before = {path: path.stat().st_mtime_ns for path in root.rglob("*") if path.is_file()}
        run = command(root, f"stages.{stage}", "cube")
        assert Children().run(run, **how).code == 0, run.log.read_text()
        files = [path for path in root.rglob("*") if path.is_file() and path.suffix != ".pyc"]
        files = [path for path in files if before.get(path) != path.stat().st_mtime_ns and path != run.log]
        written.append({path.relative_to(root): path.read_bytes() for path in files})
    assert written[0]
    assert written[0] == written[1]


@pytest.mark.slow
def test_all_stages_of_an_object_start_warm(built, starter):
    """None of their libraries starts a thread."""
    for stage in (*FIRST_STAGES, *OBJECT_STAGES, *ON_DEMAND):
        result = Children().run(command(built.root, f"stages.{stage}", "--help"), starter.start)
        assert result.code == 0
