"""Say of every stage whether it is up to date, why not, and what the next build would do about it."""

import hashlib
import os
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

from dvc.dependency import ParamsDependency
from dvc.exceptions import DvcException
from dvc.stage import PipelineStage, Stage
from dvc_data.hashfile.hash_info import HashInfo
from dvc_data.hashfile.meta import Meta
from dvc_data.hashfile.tree import Tree

from objectfolder.engine import failures
from objectfolder.engine.dvc import steps
from objectfolder.engine.dvc.graph import Plan, plan
from objectfolder.engine.dvc.repository import owned
from objectfolder.engine.dvc.savedruns import saved_run
from objectfolder.engine.summary import Addressed
from objectfolder.errors import ObjectFolderError
from objectfolder.workspace.code_digests import digests
from objectfolder.workspace.layout import code_list

#: What an output will hold: metadata and hash of the file, or of the files in the directory, by path in it.
Content = dict[tuple[str, ...], tuple[Meta, HashInfo]]


class State(StrEnum):
    """How a stage is now."""

    FRESH = "fresh"
    STALE = "stale"  # a dependency, a parameter, its command or an output has changed
    UPSTREAM = "upstream stale"  # nothing of its own has changed
    MISSING = "missing"  # an output is gone
    FAILED = "failed"  # at the last build, with what it would get now
    NEVER = "never built"


class Outlook(StrEnum):
    """What the next build would do."""

    SKIP = "nothing"
    RESTORE = "bring back"  # from DVC's cache
    RUN = "run"
    PERHAPS = "perhaps run"  # if what runs before it comes out different


@dataclass(frozen=True)
class StageStatus(Addressed):
    """How one stage is.

    Parameters
    ----------
    address : str
        Stage address, such as ``modal@mug``.
    state : State
        How it is now.
    outlook : Outlook
        What the next build would do.
    reasons : tuple of str
        Why it is not fresh by itself.
    waits_for : tuple of str
        Stages that it takes outputs of and that are not up to date.
    log : str
        Log of the command that failed; else empty.
    """

    address: str
    state: State
    outlook: Outlook
    reasons: tuple[str, ...] = ()
    waits_for: tuple[str, ...] = ()
    log: str = ""


def status(targets: Sequence[str] = (), root: str | Path = ".") -> list[StageStatus]:
    """Examine targets and everything upstream of them, in topological order; changes nothing.

    Parameters
    ----------
    targets : sequence of str
        As for `objectfolder.engine.build.build`.
    root : Path
        Workspace, the directory that holds ``dvc.yaml``.

    Raises
    ------
    ObjectFolderError
        If the workspace is busy or cannot be read, or a target names nothing.
    """
    root = Path(root).resolve()
    with owned(root) as repo:
        try:
            wanted = plan(repo, root, targets)
            examiner = _Examiner(wanted, root)
            return [examiner.examine(address) for address in wanted.stages]
        except DvcException as error:
            raise ObjectFolderError(f"DVC cannot read the pipeline in {root}: {error}") from error


class _Examiner:
    """Walks the graph downstream, and knows what the outputs of stages so far will be."""

    def __init__(self, wanted: Plan, root: Path):
        self.wanted = wanted
        self.root = root
        # By stage that is not fresh and path of an output; None: only a run will tell.
        self.future: dict[str, dict[str, Content | None]] = {}
        self.modules: dict[Path, str | None] = {}  # by script: digests of what it imports

    def examine(self, address: str) -> StageStatus:
        stage = self.wanted.stages[address]
        if not steps.has_command(stage):
            return self._examine_data(address, stage)
        own = ["its command changed"] if isinstance(stage, PipelineStage) and stage.cmd_changed else []
        if stage.is_callback or stage.always_changed:
            own.append("it runs every time")
        waits_for, unknown = [], False
        never = not any(out.hash_info for out in stage.outs)
        hashes: dict[int, tuple[Meta, HashInfo]] = {}
        for number, dep in enumerate(stage.deps):
            if isinstance(dep, ParamsDependency):
                own += _changed_params(dep)
                continue
            producer, expected = self._expected(address, dep.fs_path)
            if not producer:
                own += [self._change(dep) or f"{dep} {_words(word)}" for word in dep.status().values()]
            elif expected is None:
                unknown = True
                waits_for.append(producer)
            else:
                hashes[number] = expected
                if expected[1] != dep.hash_info:
                    change = self._change(dep)
                    own += [change] if change else []
                    waits_for += [] if change else [producer]
        missing, altered = _outputs(stage)
        changed = bool(own or waits_for or never)
        if never:
            state = State.NEVER
        elif own or altered:
            state = State.STALE
        elif missing:
            state = State.MISSING
        elif waits_for:
            state = State.UPSTREAM
        else:
            return StageStatus(address, State.FRESH, Outlook.SKIP)
        reasons = [] if never else own + altered + missing
        failure = failures.recall(self.root / failures.LOGS, address, stage)
        if failure is not None:
            state, reasons = State.FAILED, [failure.error, *reasons]
        future: dict[str, Content | None] = dict.fromkeys((out.fs_path for out in stage.outs), None)
        if unknown:
            outlook = Outlook.RUN if own or never else Outlook.PERHAPS
        else:
            found = _saved_run(stage, hashes, changed)
            outlook = Outlook.RESTORE if found else Outlook.RUN
            if found:
                future = {out.fs_path: _content(out) for out in found.outs}
        self.future[address] = future
        log = failure.log if failure else ""
        return StageStatus(address, state, outlook, tuple(reasons), tuple(dict.fromkeys(waits_for)), log)

    def _examine_data(self, address: str, stage: Stage) -> StageStatus:
        missing, altered = _outputs(stage)
        if not missing and not altered:
            return StageStatus(address, State.FRESH, Outlook.SKIP)
        state = State.STALE if altered else State.MISSING
        restored = missing and all(not out.changed_cache() for out in stage.outs)
        if restored or not missing:
            # Changed data is recorded as it is, what is gone comes back as it was recorded.
            present = {out.fs_path: out._get_hash_meta() for out in stage.outs if out.exists}
            self.future[address] = {
                out.fs_path: {(): present[out.fs_path]} if out.fs_path in present else _content(out)
                for out in stage.outs
            }
        else:
            self.future[address] = dict.fromkeys((out.fs_path for out in stage.outs), None)
        outlook = Outlook.RESTORE if restored else Outlook.RUN
        return StageStatus(address, state, outlook, tuple(missing + altered))

    def _expected(self, address: str, path: str) -> tuple[str, tuple[Meta, HashInfo] | None]:
        """Which stage upstream will write a path, empty if none that is not fresh; and what, if known."""
        for producer in sorted(self.wanted.upstream[address]):
            for out, content in self.future.get(producer, {}).items():
                if out.startswith(path + os.sep):
                    return producer, None  # a directory that holds the output and other things
                if path != out and not path.startswith(out + os.sep):
                    continue
                if Path(out) == self.root / code_list("").parent:
                    return producer, self._code(path)
                inside = Path(path).relative_to(out).parts
                return producer, (content or {}).get(inside)
        return "", None

    def _code(self, path: str) -> tuple[Meta, HashInfo] | None:
        """What the list of a stage's modules will be, known without running the stage that writes it."""
        text = self._modules(path)
        if text is None:
            return None
        digest = hashlib.md5(text.encode(), usedforsecurity=False).hexdigest()
        return Meta(size=len(text)), HashInfo("md5", digest)

    def _modules(self, path: str) -> str | None:
        script = Path("stages", f"{Path(path).stem}.py")
        if script not in self.modules:
            self.modules[script] = digests(script, self.root) if (self.root / script).is_file() else None
        return self.modules[script]

    def _change(self, dep: Any) -> str:
        """Name the modules that differ, if the dependency is a list of them."""
        if Path(dep.fs_path).parent != self.root / code_list("").parent or not dep.hash_info:
            return ""
        new = self._modules(dep.fs_path)
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
    return [reason for name in changed for reason in _differences(name, old.get(name), new.get(name))]


def _differences(name: str, old: Any, new: Any) -> list[str]:
    """Leaves of nested parameters that differ, with both values."""
    if isinstance(old, dict) and isinstance(new, dict):
        names = dict.fromkeys([*old, *new])
        return [text for key in names for text in _differences(f"{name}.{key}", old.get(key), new.get(key))]
    return [] if old == new else [f"{name}: {_value(old)} -> {_value(new)}"]


def _value(value: Any) -> str:
    text = "nothing" if value is None else str(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _outputs(stage: Stage) -> tuple[list[str], list[str]]:
    """What is missing of the outputs of a stage, and what of them has changed."""
    missing: list[str] = []
    altered: list[str] = []
    for out in stage.outs:
        if not out.hash_info:
            continue
        for word in out.status().values():
            if word == "not in cache":
                missing.append(f"{out} is gone from the cache" if out.exists else f"{out} is missing")
            else:
                (missing if word == "deleted" else altered).append(f"{out} {_words(word)}")
    return missing, altered


def _words(word: str) -> str:
    return {"deleted": "is missing", "modified": "changed", "new": "is new"}.get(word, f"is {word}")


def _saved_run(stage: Stage, hashes: dict[int, tuple[Meta, HashInfo]], changed: bool) -> Stage | None:
    """Give the dependencies the hashes that they will have, and look up what they were turned into before."""
    try:
        for number, dep in enumerate(stage.deps):
            if isinstance(dep, ParamsDependency):
                dep.hash_info = dep.get_hash()
            else:
                dep.meta, dep.hash_info = hashes[number] if number in hashes else dep._get_hash_meta()
        return saved_run(stage, changed)
    except (DvcException, OSError):  # a dependency is missing: the stage will fail
        return None


def _content(out: Any) -> Content:
    content: Content = {(): (out.meta, out.hash_info)}
    tree = out.get_obj() if out.hash_info.isdir else None
    if isinstance(tree, Tree):
        content |= {parts: (meta or Meta(), found) for parts, meta, found in tree if found}
    return content
