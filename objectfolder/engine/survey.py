"""Hash every recorded file and cached object, and validate every artifact."""

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from objectfolder.engine.dvc.recorded import (
    RecordedFile,
    cache_hash_name,
    cached_objects,
    file_hash,
    listing_of,
    recorded_outputs,
    records,
    with_downstream,
)
from objectfolder.engine.dvc.repository import OpenRepository
from objectfolder.engine.dvc.runcache import hashes_in, maker, outputs_of, read_entry, saved_runs
from objectfolder.engine.process import process_pool
from objectfolder.engine.resources import cores
from objectfolder.workspace.layout import Build
from objectfolder.workspace.params import differences
from objectfolder.workspace.validate import find_problem, readers

#: Number of artifacts from which validation uses processes.
PROCESS_THRESHOLD = 200

#: Wraps an iteration of known length in a progress bar.
Track = Callable[[Iterable[Any], str, int], Iterable[Any]]


@dataclass
class Survey:
    """Recorded files, and their state on disk."""

    root: Path
    files: list[RecordedFile] = field(default_factory=list)  #: recorded files, also those in directories
    folders: list[RecordedFile] = field(default_factory=list)  #: recorded directories
    others: dict[Path, str] = field(default_factory=dict)  #: hashes of cached objects that no stage refers to
    #: Hashes found; for an unreadable file, the reason instead.
    hashes: dict[Path, str] = field(default_factory=dict)
    #: Problems of artifacts with the right hash that their reader rejects.
    invalid: dict[Path, str] = field(default_factory=dict)
    #: Stages whose outputs a saved run made from other inputs than those recorded, with the differences.
    misrecorded: dict[str, str] = field(default_factory=dict)
    #: Stages that cannot be rebuilt, because a source upstream is not as recorded.
    blocked: set[str] = field(default_factory=set)
    #: Sizes of the files that were read, by device and inode.
    sizes: dict[tuple[int, int], int] = field(default_factory=dict)

    def matches(self, path: Path | None, oid: str) -> bool:
        """Return whether a file has a hash."""
        return path is not None and self.hashes.get(path) == oid.removesuffix(".dir")

    def problem(self, path: Path) -> str:
        """Describe a file that does not have its hash."""
        found = self.hashes.get(path, "")
        return "is missing" if not found else found if " " in found else "is damaged"

    def listing(self, folder: RecordedFile) -> bytes | None:
        """Return the listing of a directory as it is in the workspace, if that is what was recorded."""
        found = walk(folder.path)
        digests = {p.relative_to(folder.path).parts: self.hashes.get(p, "") for p in found}
        oid, text = listing_of(digests)
        return text if oid == folder.oid else None

    def strays(self, folder: RecordedFile) -> list[Path]:
        """List the files in a directory that were not recorded."""
        expected = {f.path for f in self.files if f.out is folder.out}
        return [path for path in walk(folder.path) if path not in expected]

    def bad_objects(self) -> set[str]:
        """Return the hashes of cached objects that are damaged, invalid, or missing though recorded."""
        recorded = (*self.files, *self.folders)
        named = {f.oid for f in recorded if f.cached and not self.matches(f.cached, f.oid)}
        invalid = {f.oid for f in self.files if f.path in self.invalid}
        return named | invalid | {o for path, o in self.others.items() if not self.matches(path, o)}


def take_survey(repository: OpenRepository, targets: Sequence[str], jobs: int | None, track: Track) -> Survey:
    """Hash what the lock files describe and, without targets, the whole cache; validate the artifacts.

    ``targets``: as for `objectfolder.engine.build.build`; ``jobs``: threads; default: all cores; ``track``:
    wraps iterations in a progress bar.
    """
    survey = Survey(repository.root, misrecorded=_find_misrecorded(repository, targets))
    for found in recorded_outputs(repository, targets):
        (survey.folders if found.oid.endswith(".dir") else survey.files).append(found)
    with ThreadPoolExecutor(jobs or cores()) as pool:

        def hash_all(wanted: dict[Path, str], description: str) -> None:
            survey.hashes |= _hashes(
                wanted, survey.sizes, lambda f, items: track(pool.map(f, items), description, len(items))
            )

        hash_all({f.cached: f.hash_name for f in survey.folders if f.cached}, "reading lists")
        for folder in survey.folders:
            if survey.matches(folder.cached, folder.oid):
                survey.files += folder.members()
        wanted = {path: f.hash_name for f in survey.files for path in (f.path, f.cached) if path is not None}
        for folder in survey.folders:
            # The whole directory: unrecorded files, and those that a damaged listing would name.
            wanted |= dict.fromkeys(walk(folder.path), folder.hash_name)
        if not targets:
            known = {f.cached for f in (*survey.files, *survey.folders)}
            survey.others = {p: oid for p, oid in cached_objects(repository) if p not in known}
            wanted |= dict.fromkeys(survey.others, cache_hash_name(repository))
        hash_all(wanted, "reading")
        survey.blocked = _find_blocked(repository, survey)
    _validate(survey, jobs, track)
    return survey


def runs_by_object(repository: OpenRepository, survey: Survey) -> dict[str, list[Path]]:
    """Return the saved runs that refer to each bad object."""
    bad = survey.bad_objects()
    found: dict[str, list[Path]] = {}
    for path in saved_runs(repository.repo) if bad else ():
        for oid in bad & {*hashes_in(outputs_of(read_entry(path)))}:
            found.setdefault(oid, []).append(path)
    return found


def _find_misrecorded(repository: OpenRepository, targets: Sequence[str]) -> dict[str, str]:
    found = {}
    for address, _, record in records(repository, targets):
        if run := maker(repository.repo.stage_cache, record):
            found[address] = "; ".join(differences("", run.get("params"), record.get("params")))
    return found


def walk(folder: Path) -> list[Path]:
    """List the files in a directory, sorted; empty if it does not exist."""
    return sorted(path for path in folder.rglob("*") if path.is_file()) if folder.is_dir() else []


def _hashes(wanted: dict[Path, str], sizes: dict[tuple[int, int], int], run: Any) -> dict[Path, str]:
    """Hash files, each inode once; leave out missing ones, and give the reason for unreadable ones."""
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
            sizes[by_path[path]] = info.st_size

    def digest(item: tuple[Path, str]) -> str:
        try:
            return file_hash(*item)
        except OSError as error:
            return f"cannot be read ({error.strerror})"

    found = dict(zip(inodes, run(digest, list(inodes.values()))))
    return {path: found[inode] for path, inode in by_path.items()}


def _validate(survey: Survey, jobs: int | None, track: Track) -> None:
    """Read every artifact with the right hash as its users do.

    Threads hardly help because reading is mostly computation; processes take seconds to start.
    """
    keys = {f.address.partition("@")[2] for f in survey.files} - {""}
    tables = {key: readers(Build(key, survey.root)) for key in keys}
    todo = [
        (key, survey.root, f.path)
        for f in survey.files
        if f.path in tables.get(key := f.address.partition("@")[2], {}) and survey.matches(f.path, f.oid)
    ]
    executor: Executor = process_pool(jobs) if len(todo) >= PROCESS_THRESHOLD else ThreadPoolExecutor(jobs)
    with executor as pool:
        problems = track(pool.map(_problem, todo), "validating", len(todo))
        survey.invalid |= {path: problem for (*_, path), problem in zip(todo, problems) if problem}


def _problem(item: tuple[str, Path, Path]) -> str:
    key, root, path = item
    return find_problem(readers(Build(key, root))[path], path)


def _find_blocked(repository: OpenRepository, survey: Survey) -> set[str]:
    """Return the stages that a build would run on a source that differs from the record.

    A build takes such a source for the user's edit and records it.
    """
    unsound = [f.out for f in survey.files if not f.rebuildable and not _is_restorable(survey, f)]
    unsound += [f.out for f in survey.folders if not f.rebuildable and _is_altered(survey, f)]
    return with_downstream(repository, unsound)


def _is_restorable(survey: Survey, file: RecordedFile) -> bool:
    """Return whether a source is as recorded, or missing but in the cache."""
    missing = file.path not in survey.hashes
    return survey.matches(file.path, file.oid) or (missing and survey.matches(file.cached, file.oid))


def _is_altered(survey: Survey, folder: RecordedFile) -> bool:
    """Return whether a directory has unrecorded files, or a damaged listing that cannot be recreated."""
    if survey.matches(folder.cached, folder.oid):
        return bool(survey.strays(folder))
    return survey.listing(folder) is None
