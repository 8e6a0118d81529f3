"""Files that the lock files describe, in the workspace and in the cache."""

import json
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import dvc
import networkx as nx
from dvc.dependency import Dependency, ParamsDependency
from dvc.exceptions import DvcException
from dvc.lock import Lock
from dvc.output import Output
from dvc.stage import PipelineStage, Stage
from dvc_data.hashfile.hash import file_md5
from dvc_data.hashfile.hash_info import HashInfo
from dvc_data.hashfile.meta import Meta
from dvc_data.hashfile.tree import Tree

from objectfolder.engine.dvc import steps
from objectfolder.engine.dvc.graph import address_of, all_stages, stage_graph
from objectfolder.engine.dvc.repository import OpenRepository

#: Permissions by which DVC marks a cached object whose hash is known.
READ_ONLY = 0o444
KINDS = {Dependency, Output, ParamsDependency}  #: whose state is that of a file or folder


@dataclass(frozen=True)
class RecordedFile:
    """A file or directory that a lock file describes."""

    address: str  #: stage that writes it
    out: Any  #: output that it is, or is part of
    path: Path
    oid: str  #: recorded hash; ends in ``.dir`` for a directory
    hash_name: str  #: kind of the hash
    cached: Path | None  #: path in the cache, of the listing if it is a directory; None if it is not cached

    @property
    def rebuildable(self) -> bool:
        """Whether a command writes it."""
        return steps.has_command(self.out.stage)

    def members(self) -> Iterator["RecordedFile"]:
        """Yield the files of a directory from its listing in the cache, which must be valid."""
        if self.cached is not None:
            for member in json.loads(self.cached.read_text()):
                cached = Path(self.out.cache.oid_to_path(member["md5"]))
                yield replace(self, path=self.path / member["relpath"], oid=member["md5"], cached=cached)


def recorded_outputs(repository: OpenRepository, targets: Sequence[str]) -> Iterator[RecordedFile]:
    """Yield the recorded outputs of targets and everything upstream; without targets, of all stages."""
    stages = stage_graph(repository, targets).stages if targets else all_stages(repository)
    for address, stage in stages.items():
        for out in stage.outs:
            if out.hash_info:
                oid = out.hash_info.value
                cached = Path(out.cache.oid_to_path(oid)) if out.use_cache else None
                yield RecordedFile(address, out, Path(out.fs_path), oid, out.hash_name, cached)


def other_files(repository: OpenRepository, stages: Iterable[Stage]) -> list[str] | None:
    """Return the paths outside the folders of a workspace on which the state of stages depends.

    They are settings, cached objects, and the folder of the installed libraries. None if the state depends on
    more than local files, or on what is elsewhere.
    """
    repo, root = repository.repo, repository.root
    if Path(repo.root_dir) != root or not isinstance(repo.lock, Lock):
        return None
    found = {*repo.config.files.values(), str(Path(dvc.__file__).parents[1])}
    for stage in stages:
        items = (*stage.deps, *stage.outs)
        kinds = {ParamsDependency if isinstance(item, ParamsDependency) else type(item) for item in items}
        if not kinds <= KINDS or any(item.protocol != "local" for item in items):
            return None
        paths = [os.path.relpath(path, root) for path in (stage.path, *(item.fs_path for item in items))]
        if any(path.startswith(".") for path in paths):  # hidden, or not in the workspace
            return None
        for out in stage.outs:
            if out.use_cache and out.hash_info:
                tree = out.get_obj() if out.hash_info.isdir else ()
                members = [info.value for _, _, info in tree] if isinstance(tree, Tree) else []
                found |= {out.cache.oid_to_path(oid) for oid in (out.hash_info.value, *members)}
    folders = [repository.cache, *repository.cache.glob("[0-9a-f][0-9a-f]")]  # what is left there goes
    return [*found, *map(str, folders)]


def records(repository: OpenRepository, targets: Sequence[str]) -> Iterator[tuple[str, Path, dict[str, Any]]]:
    """Yield address, lock file and entry of each recorded stage; targets as in `recorded_outputs`."""
    stages = stage_graph(repository, targets).stages if targets else all_stages(repository)
    for address, stage in stages.items():
        if isinstance(stage, PipelineStage):
            path = Path(stage.dvcfile.path).absolute().with_suffix(".lock")
            if entry := repository.lockfiles.stages(path).get(stage.name):
                yield address, path, entry


def cached_objects(repository: OpenRepository) -> Iterator[tuple[Path, str]]:
    """Yield path and hash of every cached object."""
    for path in repository.cache.glob("??/*"):
        oid = path.parent.name + path.name
        if len(oid.removesuffix(".dir")) == 32 and path.is_file():
            yield path, oid


def cache_hash_name(repository: OpenRepository) -> str:
    """Return the kind of the hashes of cached objects."""
    return str(repository.repo.cache.local.hash_name)


def file_hash(path: Path, hash_name: str) -> str:
    """Return DVC's hash of a file."""
    return str(file_md5(str(path), name=hash_name))


def listing_of(digests: Mapping[tuple[str, ...], str]) -> tuple[str, bytes]:
    """Return hash and content of the listing of a directory, from the hashes of its files by path parts."""
    tree = Tree()
    for parts, digest in digests.items():
        tree.add(parts, Meta(), HashInfo("md5", digest))
    tree.digest()
    return (str(tree.hash_info.value) if tree.hash_info else ""), tree.as_bytes()


def with_downstream(repository: OpenRepository, outs: Iterable[Any]) -> set[str]:
    """Return the addresses of the stages of outputs and of everything downstream."""
    graph = repository.repo.index.graph  # edges point from a stage to its dependencies
    stages = {out.stage for out in outs}
    found = set().union(stages, *(nx.ancestors(graph, stage) for stage in stages))
    return {address_of(stage, repository.root) for stage in found}


def check_out(outs: Iterable[Any]) -> None:
    """Restore outputs from the cache; skip those that are incomplete."""
    for out in outs:
        with suppress(DvcException):
            out.checkout(force=True)
