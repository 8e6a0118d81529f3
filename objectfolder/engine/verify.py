"""Read every artifact and cached object again, compare it with the lock file, and repair what is bad.

DVC trusts a cached object because it is read-only, and a checked-out file because its time and size are those
that it noted: bytes that went bad in place are delivered silently. Here nothing is believed but hashes.
"""

import json
import os
import shutil
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import networkx as nx
from dvc.exceptions import DvcException
from dvc.repo import Repo
from dvc.stage import Stage
from dvc_data.hashfile.hash import file_md5
from dvc_data.hashfile.hash_info import HashInfo
from dvc_data.hashfile.meta import Meta
from dvc_data.hashfile.tree import Tree

from objectfolder.engine.build import Options, build
from objectfolder.engine.dvc import steps
from objectfolder.engine.dvc.graph import address_of, plan
from objectfolder.engine.dvc.repository import owned
from objectfolder.engine.dvc.savedruns import entries, outputs, remove
from objectfolder.engine.pool import process_pool
from objectfolder.engine.summary import Addressed, Listener, Summary
from objectfolder.errors import ObjectFolderError
from objectfolder.io import atomic
from objectfolder.workspace.layout import Build
from objectfolder.workspace.validate import find_problem, readers

READ_ONLY = 0o444  # DVC's mark of a cached object whose hash is known

MANY = 200  # artifacts that are worth processes of their own

#: Wraps an iteration of known length in a progress bar.
Track = Callable[[Iterable[Any], str, int], Iterable[Any]]


@dataclass(frozen=True)
class Finding(Addressed):
    """One thing that is wrong.

    Parameters
    ----------
    address : str
        Stage that it belongs to; empty if no stage refers to it now.
    path : str
        File, relative to the workspace.
    problem : str
        What is wrong with it.
    remedy : str
        What to do about it.
    """

    address: str
    path: str
    problem: str
    remedy: str


@dataclass(frozen=True)
class Report:
    """What a verification found.

    Parameters
    ----------
    findings : tuple of Finding
    files : int
        Different files that were read.
    bytes : int
        Their size.
    rebuilt : Summary, optional
        Of the build that a repair needed.
    """

    findings: tuple[Finding, ...]
    files: int
    bytes: int
    rebuilt: Summary | None = None


@dataclass(frozen=True)
class _File:
    """A file that the lock file describes: in the workspace, and, if it is cached, in the cache."""

    address: str
    out: Any
    path: Path
    oid: str
    hash_name: str
    cached: Path | None

    @property
    def rebuildable(self) -> bool:
        return steps.has_command(self.out.stage)


@dataclass
class _Survey:
    """Everything to look at, and what was seen."""

    root: Path
    files: list[_File] = field(default_factory=list)
    folders: list[_File] = field(default_factory=list)  # ``path`` is the directory, ``cached`` its list
    others: dict[Path, str] = field(default_factory=dict)  # cached objects that no stage refers to: hash
    hashes: dict[Path, str] = field(default_factory=dict)
    invalid: dict[Path, str] = field(default_factory=dict)
    blocked: set[str] = field(default_factory=set)  # stages that cannot be rebuilt: a source is not right
    seen: dict[tuple[int, int], int] = field(default_factory=dict)  # sizes of the inodes that were read

    def good(self, path: Path | None, oid: str) -> bool:
        return path is not None and self.hashes.get(path) == oid.removesuffix(".dir")

    def words(self, path: Path) -> str:
        found = self.hashes.get(path, "")
        return "is missing" if not found else found if " " in found else "is damaged"


def verify(
    targets: Sequence[str] = (),
    root: str | Path = ".",
    repair: bool = False,
    jobs: int | None = None,
    track: Track = lambda items, *_: items,
    on_event: Listener = lambda event: None,
) -> Report:
    """Hash again what the lock file describes, and read every artifact as its users do.

    Parameters
    ----------
    targets : sequence of str
        As for `objectfolder.engine.build.build`, with everything upstream; none means the whole workspace
        and the whole cache, also what only earlier states refer to.
    root : Path
        Workspace, the directory that holds ``dvc.yaml``.
    repair : bool
        Restore what is good in the other place, rebuild what is not, and verify again.
    jobs : int, optional
        Threads that read, and cores for a rebuild; default: all.
    track : callable
        Wraps iterations in a progress bar.
    on_event : callable
        Listens to the rebuild.

    Raises
    ------
    ObjectFolderError
        If the workspace is busy or cannot be read, or a target names nothing.
    """
    root = Path(root).resolve()
    with owned(root) as repo:
        try:
            survey = _survey(repo, root, targets, jobs, track)
            findings = _findings(survey, _references(repo, survey))
            if not repair or not findings:
                return _report(survey, findings)
            bad = _bad_objects(survey)
            rebuild = _repair(survey)
        except DvcException as error:
            raise ObjectFolderError(f"DVC cannot verify {root}: {error}") from error
    summary = build(sorted(rebuild), Options(jobs=jobs), root, on_event) if rebuild else None
    with owned(root) as repo:
        _drop_dead_runs(repo, bad)
        survey = _survey(repo, root, targets, jobs, track)
        return replace(_report(survey, _findings(survey, _references(repo, survey))), rebuilt=summary)


def _report(survey: _Survey, findings: list[Finding]) -> Report:
    return Report(tuple(findings), len(survey.seen), sum(survey.seen.values()))


def _survey(repo: Repo, root: Path, targets: Sequence[str], jobs: int | None, track: Track) -> _Survey:
    survey = _Survey(root)
    stages = _stages(repo, root, targets)
    with ThreadPoolExecutor(jobs or os.cpu_count()) as pool:

        def hash_all(wanted: dict[Path, str], description: str) -> None:
            survey.hashes |= _hashes(
                wanted, survey.seen, lambda f, items: track(pool.map(f, items), description, len(items))
            )

        for address, stage in stages.items():
            for out in stage.outs:
                if out.hash_info:
                    cached = Path(out.cache.oid_to_path(out.hash_info.value)) if out.use_cache else None
                    found = _File(address, out, Path(out.fs_path), out.hash_info.value, out.hash_name, cached)
                    (survey.folders if out.hash_info.isdir else survey.files).append(found)
        hash_all({f.cached: f.hash_name for f in survey.folders if f.cached}, "reading lists")
        for folder in survey.folders:
            survey.files += _members(survey, folder)
        wanted = {path: f.hash_name for f in survey.files for path in (f.path, f.cached) if path is not None}
        for folder in survey.folders:
            # All of the directory: what is in it but not on its list, and what a damaged list would name.
            wanted |= dict.fromkeys(_walk(folder.path), folder.hash_name)
        if not targets:
            known = {f.cached for f in (*survey.files, *survey.folders)}
            survey.others = {p: oid for p, oid in _objects(repo) if p not in known}
            wanted |= dict.fromkeys(survey.others, repo.cache.local.hash_name)
        hash_all(wanted, "reading")
        survey.blocked = _blocked(repo, survey)
    _validate(survey, jobs, track)
    return survey


def _stages(repo: Repo, root: Path, targets: Sequence[str]) -> dict[str, Stage]:
    if targets:
        return plan(repo, root, targets).stages
    return {address_of(stage, root): stage for stage in repo.index.stages}


def _hashes(wanted: dict[Path, str], seen: dict[tuple[int, int], int], run: Any) -> dict[Path, str]:
    """Hash files, each inode once; a file that is not there has none, an unreadable one says why."""
    inodes: dict[tuple[int, int], tuple[Path, str]] = {}
    by_path: dict[Path, tuple[int, int]] = {}
    for path, name in wanted.items():
        try:
            info = path.stat()
        except OSError:
            continue
        if path.is_file():
            by_path[path] = info.st_dev, info.st_ino
            inodes.setdefault(by_path[path], (path, name))
            seen[by_path[path]] = info.st_size

    def digest(item: tuple[Path, str]) -> str:
        try:
            return file_md5(str(item[0]), name=item[1])
        except OSError as error:
            return f"cannot be read ({error.strerror})"

    found = dict(zip(inodes, run(digest, list(inodes.values()))))
    return {path: found[inode] for path, inode in by_path.items()}


def _members(survey: _Survey, folder: _File) -> Iterator[_File]:
    """Files of a directory, from its list in the cache; none if that is damaged."""
    if folder.cached is None or not survey.good(folder.cached, folder.oid):
        return
    for member in json.loads(folder.cached.read_text()):
        cached = Path(folder.out.cache.oid_to_path(member["md5"]))
        yield replace(folder, path=folder.path / member["relpath"], oid=member["md5"], cached=cached)


def _walk(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.is_file()) if folder.is_dir() else []


def _objects(repo: Repo) -> Iterator[tuple[Path, str]]:
    """Objects in the cache, with their names' hashes."""
    for path in Path(repo.cache.local.path).glob("??/*"):
        oid = path.parent.name + path.name
        if len(oid.removesuffix(".dir")) == 32 and path.is_file():
            yield path, oid


def _validate(survey: _Survey, jobs: int | None, track: Track) -> None:
    """Let the readers of all artifacts whose bytes are right read them.

    They compute more than they read, so threads hardly help; processes take seconds to start.
    """
    tables = {
        key: readers(Build(key, survey.root))
        for key in {f.address.partition("@")[2] for f in survey.files}
        if key
    }
    todo = [
        (f.address.partition("@")[2], survey.root, f.path)
        for f in survey.files
        if (table := tables.get(f.address.partition("@")[2], {}))
        and f.path in table
        and survey.good(f.path, f.oid)
    ]
    many = len(todo) >= MANY
    executor: Executor = process_pool(jobs) if many else ThreadPoolExecutor(jobs)
    with executor as pool:
        problems = track(pool.map(_problem, todo), "validating", len(todo))
        survey.invalid |= {path: problem for (*_, path), problem in zip(todo, problems) if problem}


def _problem(item: tuple[str, Path, Path]) -> str:
    key, root, path = item
    return find_problem(readers(Build(key, root))[path], path)


def _blocked(repo: Repo, survey: _Survey) -> set[str]:
    """Stages that a build would feed with a source that differs from what was recorded.

    A build takes what is there for the user's edit, and records it.
    """
    unsound = {f.out.stage for f in survey.files if not f.rebuildable and not _restorable(survey, f)}
    unsound |= {f.out.stage for f in survey.folders if not f.rebuildable and _unlisted(survey, f)}
    graph = repo.index.graph  # edges go from a stage to what it depends on
    blocked = set().union(unsound, *(nx.ancestors(graph, stage) for stage in unsound))
    return {address_of(stage, survey.root) for stage in blocked}


def _restorable(survey: _Survey, file: _File) -> bool:
    """Whether a source is right, or gone and in the cache."""
    gone = file.path not in survey.hashes
    return survey.good(file.path, file.oid) or (gone and survey.good(file.cached, file.oid))


def _unlisted(survey: _Survey, folder: _File) -> bool:
    """Whether the list of a directory is damaged and cannot be written again, or files were added."""
    if folder.cached and survey.good(folder.cached, folder.oid):
        return bool(_strays(survey, folder))
    return _tree(survey, folder) is None


def _strays(survey: _Survey, folder: _File) -> list[Path]:
    expected = {f.path for f in survey.files if f.out is folder.out}
    return [path for path in _walk(folder.path) if path not in expected]


def _bad_objects(survey: _Survey) -> set[str]:
    """Hashes of cached objects that are damaged, or not there though the lock file names them."""
    named = {f.oid for f in (*survey.files, *survey.folders) if f.cached and not survey.good(f.cached, f.oid)}
    invalid = {f.oid for f in survey.files if f.path in survey.invalid}
    return named | invalid | {oid for path, oid in survey.others.items() if not survey.good(path, oid)}


def _references(repo: Repo, survey: _Survey) -> dict[str, list[Path]]:
    """Entries of the run cache by the bad object that they name."""
    bad = _bad_objects(survey)
    found: dict[str, list[Path]] = {}
    for path in entries(repo) if bad else ():
        text = outputs(path.read_text(errors="replace"))
        for oid in bad:
            if f"md5: {oid}\n" in text:
                found.setdefault(oid, []).append(path)
    return found


def _findings(survey: _Survey, references: dict[str, list[Path]]) -> list[Finding]:
    found = []

    def add(file: _File, problem: str, remedy: str) -> None:
        found.append(Finding(file.address, _relative(file.path, survey.root), problem, remedy))

    for folder in survey.folders:
        if folder.cached and not survey.good(folder.cached, folder.oid):
            whole = _tree(survey, folder) is not None
            remedy = "--repair writes it again" if whole else _rebuilds(survey, folder)
            add(folder, f"its list in the cache {survey.words(folder.cached)}", remedy)
        elif folder.cached:
            for path in _strays(survey, folder):
                remedy = "--repair removes it" if folder.rebuildable else _left(folder)
                add(replace(folder, path=path), "is not one of the files that were recorded", remedy)
        elif _tree(survey, folder) is None:
            add(folder, "differs from what was recorded", _rebuilds(survey, folder))
    for file in survey.files:
        here, there = survey.good(file.path, file.oid), survey.good(file.cached, file.oid)
        saved = len(references.get(file.oid, ()))
        if file.cached and not there:
            runs = (
                f" ({saved} saved runs would bring it back)" if saved and file.cached in survey.hashes else ""
            )
            remedy = "--repair copies the checked-out file there" if here else _rebuilds(survey, file)
            add(file, f"its object in the cache {survey.words(file.cached)}{runs}", remedy)
        if not here:
            problem = survey.words(file.path).replace("is damaged", "differs from what was recorded")
            if there and (file.rebuildable or file.path not in survey.hashes):
                remedy = "--repair takes it from the cache"
            else:
                remedy = _left(file) if there else _rebuilds(survey, file)
            add(file, problem, remedy)
        elif file.path in survey.invalid:
            add(file, survey.invalid[file.path], _rebuilds(survey, file))
    for path, oid in survey.others.items():
        if not survey.good(path, oid):
            problem = f"{survey.words(path)}; no stage refers to it now"
            if oid in references:
                problem += f", but {len(references[oid])} saved runs would bring it back"
            found.append(Finding("", _relative(path, survey.root), problem, "--repair removes it"))
    return found


def _rebuilds(survey: _Survey, file: _File) -> str:
    if file.rebuildable and file.address in survey.blocked:
        return "--repair rebuilds it once its source is right"
    if file.rebuildable:
        return "--repair rebuilds it"
    return f"`dvc pull {file.address}`, or remove the object and add it again: it cannot be rebuilt"


def _left(file: _File) -> str:
    return (
        f"if you changed it, `dvc commit {file.address}`; if not, delete it, and `dvc checkout "
        f"{file.address}` brings the recorded one back"
    )


def _repair(survey: _Survey) -> set[str]:
    """Restore what can be proven good, remove what is bad; returns the stages to run again.

    Bad files go before good ones come, one rename at a time: killed anywhere, what is good is still there.
    """
    rebuild: set[str] = set()  # never what is blocked: it keeps what it has
    checkout: dict[str, Any] = {}
    for folder in survey.folders:
        if folder.cached is None:
            if _tree(survey, folder) is None and folder.address not in survey.blocked:
                shutil.rmtree(folder.path, ignore_errors=True)
                rebuild.add(folder.address)
        elif not survey.good(folder.cached, folder.oid):
            tree = _tree(survey, folder)
            folder.cached.unlink(missing_ok=True)
            if tree is None:
                rebuild |= {folder.address} - survey.blocked
            else:
                folder.cached.parent.mkdir(parents=True, exist_ok=True)
                with atomic(folder.cached) as temporary:
                    temporary.write_bytes(tree.as_bytes())
                    temporary.chmod(READ_ONLY)
        elif folder.rebuildable:
            checkout[folder.out.fs_path] = folder.out  # removes what does not belong there

    def good(file: _File, path: Path | None) -> bool:
        return file.path not in survey.invalid and survey.good(path, file.oid)

    for file in survey.files:  # first, as other files may be the same object
        if file.cached and good(file, file.path) and not good(file, file.cached):
            _cache(file)
            survey.hashes[file.cached] = file.oid
    for file in survey.files:
        here, there = good(file, file.path), good(file, file.cached)
        if there and not here:
            if file.rebuildable or file.path not in survey.hashes:
                file.path.unlink(missing_ok=True)
                checkout[file.out.fs_path] = file.out
        elif not here:
            if file.cached:
                file.cached.unlink(missing_ok=True)
            if file.address not in survey.blocked:
                file.path.unlink(missing_ok=True)
                rebuild.add(file.address)
    for path, oid in survey.others.items():
        if not survey.good(path, oid):
            path.unlink(missing_ok=True)
    for out in checkout.values():
        with suppress(DvcException):  # something else of it is rebuilt
            out.checkout(force=True)
    return rebuild


def _cache(file: _File) -> None:
    """Put a checked-out file whose hash is right into the cache, in place of what is there."""
    assert file.cached is not None
    file.cached.parent.mkdir(parents=True, exist_ok=True)
    with atomic(file.cached) as temporary:
        temporary.unlink()  # what a killed repair left is read-only
        shutil.copyfile(file.path, temporary)
        if file_md5(str(temporary), name=file.hash_name) != file.oid:
            raise ObjectFolderError(f"{file.path} changed while it was read; verify again")
        temporary.chmod(READ_ONLY)


def _tree(survey: _Survey, folder: _File) -> Tree | None:
    """List of a directory as it is checked out, if that is what was recorded."""
    tree = Tree()
    for path in _walk(folder.path):
        parts = path.relative_to(folder.path).parts
        tree.add(parts, Meta(), HashInfo("md5", survey.hashes.get(path, "")))
    tree.digest()
    return tree if tree.hash_info and tree.hash_info.value == folder.oid else None


def _drop_dead_runs(repo: Repo, bad: set[str]) -> None:
    """Remove saved runs that name what was bad and has not come back; DVC would find nothing older."""
    gone = [oid for oid in bad if not Path(repo.cache.local.oid_to_path(oid)).exists()]
    for path in entries(repo) if gone else ():
        text = outputs(path.read_text(errors="replace"))
        if any(f"md5: {oid}\n" in text for oid in gone):
            remove(path)


def _relative(path: Path, root: Path) -> str:
    return os.path.relpath(path, root)
