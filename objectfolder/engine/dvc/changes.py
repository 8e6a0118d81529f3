"""Differences between stages and their records, and the outputs that the next build will restore."""

import hashlib
import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from dvc.dependency import ParamsDependency
from dvc.exceptions import DvcException
from dvc.stage import PipelineStage, Stage
from dvc_data.hashfile.hash_info import HashInfo
from dvc_data.hashfile.meta import Meta
from dvc_data.hashfile.tree import Tree

from objectfolder.engine.dvc import steps
from objectfolder.engine.dvc.graph import StageGraph
from objectfolder.engine.dvc.recorded import listing_of
from objectfolder.engine.dvc.runcache import find_saved_run, is_there
from objectfolder.workspace.code_digests import code_text
from objectfolder.workspace.layout import CODE
from objectfolder.workspace.params import differences

#: Future content of an output: metadata and hash by path inside it; a file has the empty path.
Content = dict[tuple[str, ...], tuple[Meta, HashInfo]]


@dataclass(frozen=True)
class Changes:
    """Differences between a stage and its record."""

    #: Changes of its command, parameters, and dependencies that no stale stage writes.
    inputs: tuple[str, ...] = ()
    missing: tuple[str, ...] = ()  #: outputs that are missing
    altered: tuple[str, ...] = ()  #: outputs that differ from the record
    #: Upstream stages that are not up to date and will change its dependencies.
    waits_for: tuple[str, ...] = ()
    recorded: bool = True  #: whether it has ever been built
    predictable: bool = True  #: whether the dependencies that it will get are known without running anything
    restorable: bool = False  #: whether its outputs will come from the cache

    @property
    def fresh(self) -> bool:
        """Whether there are none."""
        return self.recorded and not (self.inputs or self.missing or self.altered or self.waits_for)


class ChangeTracker:
    """Finds the changes of stages in topological order, predicting the outputs of stale stages."""

    def __init__(self, graph: StageGraph, root: Path):
        self.graph = graph
        self.root = root
        # By stale stage and path of an output; None if only a run can tell.
        self.future: dict[str, dict[str, Content | None]] = {}
        self.code: dict[str, str | None] = {}  # digests of the modules of a stage, by its name

    def changes(self, address: str) -> Changes:
        """Compare a stage with its record; stages upstream must have been compared before."""
        stage = self.graph.stages[address]
        if not steps.has_command(stage):
            return self._data_changes(address, stage)
        own = ["its command changed"] if isinstance(stage, PipelineStage) and stage.cmd_changed else []
        if stage.is_callback or stage.always_changed:
            own.append("it runs every time")
        waits_for, predictable = [], True
        hashes: dict[int, tuple[Meta, HashInfo]] = {}
        for number, dep in enumerate(stage.deps):
            if isinstance(dep, ParamsDependency):
                own += _changed_params(dep)
                continue
            producer, expected = self._expected(address, dep)
            if not producer:
                own += [self._code_change(dep) or f"{dep} {_words(word)}" for word in dep.status().values()]
            elif expected is None:
                predictable = False
                waits_for.append(producer)
            else:
                hashes[number] = expected
                if expected[1] != dep.hash_info:
                    change = self._code_change(dep)
                    own += [change] if change else []
                    waits_for += [] if change else [producer]
        missing, altered = _output_changes(stage)
        recorded = any(out.hash_info for out in stage.outs)
        found = Changes(tuple(own), missing, altered, tuple(dict.fromkeys(waits_for)), recorded, predictable)
        if found.fresh:
            return found
        run = _find_run(stage, hashes, bool(own or waits_for or not recorded)) if predictable else None
        if run is None:
            self.future[address] = dict.fromkeys((out.fs_path for out in stage.outs), None)
            return found
        self.future[address] = {out.fs_path: _content(out) for out in run.outs}
        return Changes(found.inputs, missing, altered, found.waits_for, recorded, restorable=True)

    def _data_changes(self, address: str, stage: Stage) -> Changes:
        missing, altered = _output_changes(stage)
        if not missing and not altered:
            return Changes()
        restorable = bool(missing) and all(not out.changed_cache() for out in stage.outs)
        if restorable or not missing:
            # A build records changed data as it is, and restores missing data as recorded.
            present = {out.fs_path: out._get_hash_meta() for out in stage.outs if is_there(out)}
            self.future[address] = {
                out.fs_path: {(): present[out.fs_path]} if out.fs_path in present else _content(out)
                for out in stage.outs
            }
        else:
            self.future[address] = dict.fromkeys((out.fs_path for out in stage.outs), None)
        return Changes(missing=missing, altered=altered, restorable=restorable)

    def _expected(self, address: str, dep: Any) -> tuple[str, tuple[Meta, HashInfo] | None]:
        """Return the stale stage that will write a dependency, or nothing, and the predicted content."""
        path, first = dep.fs_path, ""
        inside: dict[tuple[str, ...], Content | None] = {}
        for producer in sorted(self.graph.upstream[address]):
            for out, content in self.future.get(producer, {}).items():
                if out.startswith(path + os.sep):  # a directory that may hold other files, too
                    inside[Path(out).relative_to(path).parts] = content
                    first = first or producer
                if path != out and not path.startswith(out + os.sep):
                    continue
                if Path(out) == self.root / CODE:
                    return producer, self._code(path)
                return producer, (content or {}).get(Path(path).relative_to(out).parts)
        return first, _directory(dep, inside) if inside else None

    def _code(self, path: str) -> tuple[Meta, HashInfo] | None:
        """Return the future content of a list of modules, predicted from the sources."""
        text = self._digests(path)
        if text is None:
            return None
        digest = hashlib.md5(text.encode(), usedforsecurity=False).hexdigest()
        return Meta(size=len(text)), HashInfo("md5", digest)

    def _digests(self, path: str) -> str | None:
        name = Path(path).relative_to(self.root / CODE).with_suffix("").as_posix()
        if name not in self.code:
            self.code[name] = code_text(name, self.root)
        return self.code[name]

    def _code_change(self, dep: Any) -> str:
        """Name the changed modules if the dependency is a list of modules; otherwise return nothing."""
        if not (Path(dep.fs_path).is_relative_to(self.root / CODE) and dep.hash_info):
            return ""
        new = self._digests(dep.fs_path)
        try:
            old = Path(dep.repo.cache.local.oid_to_path(dep.hash_info.value)).read_text()
        except OSError:
            return ""
        lines = set(old.splitlines()) ^ set((new or "").splitlines())
        return "code changed: " + ", ".join(sorted({line.split()[1] for line in lines}))


def _changed_params(dep: ParamsDependency) -> list[str]:
    changed = dep.status().get(str(dep), {})
    if isinstance(changed, str):
        return [f"{dep} {_words(changed)}"]
    old, new = dep.hash_info.value or {}, dep.read_params()
    return [reason for name in changed for reason in differences(name, old.get(name), new.get(name))]


def _output_changes(stage: Stage) -> tuple[tuple[str, ...], tuple[str, ...]]:
    missing: list[str] = []
    altered: list[str] = []
    for out in stage.outs:
        if not out.hash_info:
            continue
        for word in out.status().values():
            if word == "not in cache":
                missing.append(f"{out} is gone from the cache" if out.exists else f"{out} is missing")
            else:
                word = word if is_there(out) else "deleted"
                (missing if word == "deleted" else altered).append(f"{out} {_words(word)}")
    return tuple(missing), tuple(altered)


def _words(word: str) -> str:
    return {"deleted": "is missing", "modified": "changed", "new": "is new"}.get(word, f"is {word}")


def _find_run(stage: Stage, hashes: dict[int, tuple[Meta, HashInfo]], changed: bool) -> Stage | None:
    """Set the future hashes of the dependencies, and look up the saved run with these inputs."""
    try:
        for number, dep in enumerate(stage.deps):
            if isinstance(dep, ParamsDependency):
                dep.hash_info = dep.get_hash()
                continue
            dep.update_legacy_hash_name(
                force=True
            )  # as a build does with those that are not in the lock file
            dep.meta, dep.hash_info = hashes[number] if number in hashes else dep._get_hash_meta()
            dep.get_hash = partial(getattr, dep, "hash_info")  # DVC would ask the disk, which may lack it yet
        return find_saved_run(stage, changed)
    except (DvcException, OSError):  # a dependency is missing: the stage will fail
        return None


def _directory(dep: Any, inside: Mapping[tuple[str, ...], Content | None]) -> tuple[Meta, HashInfo] | None:
    """Return the future hash of a directory from that of the outputs in it; None if one is not known."""
    digests: dict[tuple[str, ...], str] = {}
    with suppress(DvcException, OSError):  # there is none yet
        now = dep._build(
            *(dep.cache, dep.fs_path, dep.fs, dep.hash_name),
            ignore=dep.dvcignore, dry_run=True, no_progress_bar=True,
        )[2]  # fmt: skip
        for parts, _, found in now if isinstance(now, Tree) else ():
            if not any(parts[: len(place)] == place for place in inside):
                digests[parts] = str(found.value)
    for place, content in inside.items():
        members = {parts: found for parts, (_, found) in (content or {}).items()}
        if (whole := members.pop((), None)) is None or (whole.isdir and not members):
            return None
        digests |= {(*place, *parts): str(found.value) for parts, found in (members or {(): whole}).items()}
    return Meta(isdir=True), HashInfo("md5", listing_of(digests)[0])


def _content(out: Any) -> Content:
    content: Content = {(): (out.meta, out.hash_info)}
    tree = out.get_obj() if out.hash_info.isdir else None
    if isinstance(tree, Tree):
        content |= {parts: (meta or Meta(), found) for parts, meta, found in tree if found}
    return content
