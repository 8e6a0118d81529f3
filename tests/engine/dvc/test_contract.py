"""What the engine replaces in DVC, or relies on, exists in the pinned version with the known signature."""

import inspect
from contextlib import suppress

import dvc
import pytest
from dvc.data_cloud import Remote
from dvc.dependency import ParamsDependency
from dvc.ignore import DvcIgnoreFilter
from dvc.lock import LockError
from dvc.output import Output
from dvc.repo import lock_repo
from dvc.repo.index import Index
from dvc.repo.reproduce import get_active_graph
from dvc.rwlock import RWLOCK_FILE, SCHEMA
from dvc.stage import Stage
from dvc.stage.cache import StageCache, _can_hash
from dvc.stage.run import prepare_kwargs
from dvc.stage.serialize import to_lockfile, to_single_stage_lockfile
from dvc_data.hashfile.hash import file_md5
from dvc_data.hashfile.tree import Tree

from objectfolder.engine.dvc.lockfile import LockFiles
from objectfolder.engine.dvc.replacements import DVC_VERSION, REPLACED, replacements

REPLACED_PARAMETERS = {
    "read_param_file": "fs path key_paths flatten **load_kwargs",
    "rwlock": "tmp_dir fs cmd read write hardlink",
    "set_link": "self path inode mtime",
    "_checksum": "info",
    "dump_yaml": "path data fs **kwargs",
    "_get_hash_meta": "self",
    "_load": "self **kwargs",
}
RELIED_ON = [
    (StageCache._load_cache, "self key value"),
    (StageCache._create_stage, "self cache wdir"),
    (StageCache._load, "self stage"),
    (StageCache.save, "self stage"),
    (StageCache.restore, "self stage run_cache pull dry"),
    (_can_hash, "stage"),
    (to_lockfile, "stage **kwargs"),
    (to_single_stage_lockfile, "stage **kwargs"),
    (prepare_kwargs, "stage run_env"),
    (get_active_graph, "graph"),
    (lock_repo, "repo"),
    (Stage.reproduce, "self interactive **kwargs"),
    (Stage.changed, "self allow_missing upstream"),
    (Stage.remove_outs, "self ignore_remove force"),
    (Stage.save_deps, "self allow_missing"),
    (Stage.save_outs, "self allow_missing"),
    (Stage.compute_md5, "self"),
    (Stage.commit, "self allow_missing filter_info **kwargs"),
    (Stage.checkout, "self allow_missing **kwargs"),
    (Output.get_obj, "self filter_info **kwargs"),
    (Output.clear, "self"),
    (Output.get_used_objs, "self **kwargs"),
    (Output.changed_cache, "self filter_info"),
    (Output.checkout, "self force progress_callback relink filter_info allow_missing **kwargs"),
    (Tree.add, "self key meta oid"),
    (Tree.digest, "self with_meta name"),
    (Tree.as_bytes, "self with_meta"),
    (ParamsDependency.read_params, "self flatten **kwargs"),
    (ParamsDependency.isfile, "self"),
    (DvcIgnoreFilter.find, "self fs path **kwargs"),
    (file_md5, "fname fs callback name size"),
]


def parameters(function):
    values = inspect.signature(function).parameters.values()
    return " ".join(str(v).split(":")[0].split("=")[0] for v in values)


def test_the_version_is_the_one_that_is_known():
    assert dvc.__version__ == DVC_VERSION


def test_replaced_names_have_the_known_parameters():
    found = {name: parameters(vars(owner)[name]) for owner, name in REPLACED}
    assert found == REPLACED_PARAMETERS


@pytest.mark.parametrize(("function", "expected"), RELIED_ON, ids=lambda v: getattr(v, "__qualname__", ""))
def test_names_relied_on_have_the_known_parameters(function, expected):
    assert parameters(function) == expected


def test_other_names_relied_on_exist():
    assert issubclass(LockError, Exception)
    assert RWLOCK_FILE == "rwlock"
    assert SCHEMA({}) == {"read": {}, "write": {}}
    assert "graph" in dir(Index)
    assert "stages" in inspect.signature(Index).parameters
    assert "legacy_odb" in dir(Remote)


def test_replacements_are_undone(tmp_path):
    before = [vars(owner)[name] for owner, name in REPLACED]
    with suppress(KeyboardInterrupt), replacements(LockFiles(tmp_path)):
        assert all(vars(owner)[name] is not value for (owner, name), value in zip(REPLACED, before))
        raise KeyboardInterrupt
    assert [vars(owner)[name] for owner, name in REPLACED] == before
