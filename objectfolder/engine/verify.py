"""Verify every artifact and cached object against the lock file, and repair what is bad.

DVC trusts a cached object if it is read-only, and a checked-out file if time and size are as recorded: bytes
damaged in place are delivered silently. Here, only hashes count.
"""

import os
import shutil
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.io import atomic
from objectfolder.engine.build import BuildOptions, build
from objectfolder.engine.dvc.recorded import READ_ONLY, RecordedFile, check_out, file_hash, records
from objectfolder.engine.dvc.repository import OpenRepository, open_repository
from objectfolder.engine.dvc.runcache import hashes_in, outputs_of, read_entry, remove_saved_run, saved_runs
from objectfolder.engine.summary import Addressed, Listener, Summary
from objectfolder.engine.survey import Survey, Track, runs_by_object, take_survey


@dataclass(frozen=True)
class Defect(Addressed):
    """A damaged, missing or unexpected file."""

    address: str  #: stage that it belongs to; empty if no stage refers to it
    path: str  #: file, relative to the workspace
    problem: str  #: description of the defect
    remedy: str  #: recommended action


@dataclass(frozen=True)
class VerifyReport:
    """Result of a verification."""

    findings: tuple[Defect, ...]
    files: int  #: number of distinct files read
    bytes_read: int  #: their total size
    rebuilt: Summary | None = None  #: summary of the build that a repair started


def verify(
    targets: Sequence[str] = (),
    root: str | Path = ".",
    repair: bool = False,
    jobs: int | None = None,
    track: Track = lambda items, *_: items,
    on_event: Listener = lambda event: None,
) -> VerifyReport:
    """Hash everything that the lock file describes, and read every artifact as its users do.

    Parameters
    ----------
    targets : sequence of str
        As for `objectfolder.engine.build.build`, with everything upstream; default: the whole workspace and
        the whole cache, including objects that only earlier states refer to.
    root : Path
        Workspace, the directory that holds ``dvc.yaml``.
    repair : bool
        Restore files from the place where they are intact, rebuild the others, and verify again.
    jobs : int, optional
        Threads that read, and cores for a rebuild; default: all.
    track : callable
        Wraps iterations in a progress bar.
    on_event : callable
        Receives the events of the rebuild.

    Raises
    ------
    ObjectFolderError
        If the workspace is busy or cannot be read, or a target is unknown.
    """
    with open_repository(root) as repository:
        survey = take_survey(repository, targets, jobs, track)
        defects = _defects(survey, runs_by_object(repository, survey))
        if not repair or not defects:
            return _report(survey, defects)
        bad = survey.bad_objects()
        rebuild = restore_files(survey) | forget_records(repository, survey)
    summary = build(sorted(rebuild), BuildOptions(jobs=jobs), root, on_event) if rebuild else None
    with open_repository(root) as repository:
        remove_dead_runs(repository, bad)
        survey = take_survey(repository, targets, jobs, track)
        return replace(_report(survey, _defects(survey, runs_by_object(repository, survey))), rebuilt=summary)


def _report(survey: Survey, defects: list[Defect]) -> VerifyReport:
    return VerifyReport(tuple(defects), len(survey.sizes), sum(survey.sizes.values()))


def _defects(survey: Survey, references: dict[str, list[Path]]) -> list[Defect]:
    found = []

    def add(file: RecordedFile, problem: str, remedy: str) -> None:
        found.append(Defect(file.address, os.path.relpath(file.path, survey.root), problem, remedy))

    for address, differences in survey.misrecorded.items():
        problem = f"a saved run made these outputs of other parameters than it records: {differences}"
        found.append(Defect(address, "dvc.lock", problem, "--repair runs the stage again"))
    for folder in survey.folders:
        if folder.cached and not survey.matches(folder.cached, folder.oid):
            intact = survey.listing(folder) is not None
            remedy = "--repair writes it again" if intact else _rebuilds(survey, folder)
            add(folder, f"its list in the cache {survey.problem(folder.cached)}", remedy)
        elif folder.cached:
            for path in survey.strays(folder):
                remedy = "--repair removes it" if folder.rebuildable else _keep_hint(folder)
                add(replace(folder, path=path), "is not one of the files that were recorded", remedy)
        elif survey.listing(folder) is None:
            add(folder, "differs from what was recorded", _rebuilds(survey, folder))
    for file in survey.files:
        here, there = survey.matches(file.path, file.oid), survey.matches(file.cached, file.oid)
        runs = len(references.get(file.oid, ()))
        if file.cached and not there:
            note = f" ({runs} saved runs would restore it)" if runs and file.cached in survey.hashes else ""
            remedy = "--repair copies the checked-out file there" if here else _rebuilds(survey, file)
            add(file, f"its object in the cache {survey.problem(file.cached)}{note}", remedy)
        if not here:
            problem = survey.problem(file.path).replace("is damaged", "differs from what was recorded")
            if there and (file.rebuildable or file.path not in survey.hashes):
                remedy = "--repair takes it from the cache"
            else:
                remedy = _keep_hint(file) if there else _rebuilds(survey, file)
            add(file, problem, remedy)
        elif file.path in survey.invalid:
            add(file, survey.invalid[file.path], _rebuilds(survey, file))
    for path, oid in survey.others.items():
        if not survey.matches(path, oid):
            problem = f"{survey.problem(path)}; no stage refers to it now"
            if oid in references:
                problem += f", but {len(references[oid])} saved runs would restore it"
            found.append(Defect("", os.path.relpath(path, survey.root), problem, "--repair removes it"))
    return found


def _rebuilds(survey: Survey, file: RecordedFile) -> str:
    if file.rebuildable and file.address in survey.blocked:
        return "--repair rebuilds it once its source is right"
    if file.rebuildable:
        return "--repair rebuilds it"
    return f"`dvc pull {file.address}`, or remove the object and add it again: it cannot be rebuilt"


def _keep_hint(file: RecordedFile) -> str:
    return (
        f"if you changed it, `dvc commit {file.address}`; if not, delete it, and `dvc checkout "
        f"{file.address}` brings the recorded one back"
    )


def restore_files(survey: Survey) -> set[str]:
    """Restore files from intact copies and remove bad ones.

    Every step is a removal of a bad file or one rename, so that an interrupted repair loses nothing intact.

    Returns the addresses of the stages to run again.
    """
    rebuild: set[str] = set()
    checkout: dict[str, Any] = {}
    for folder in survey.folders:
        if folder.cached is None:
            if survey.listing(folder) is None and folder.address not in survey.blocked:
                shutil.rmtree(folder.path, ignore_errors=True)
                rebuild.add(folder.address)
        elif not survey.matches(folder.cached, folder.oid):
            listing = survey.listing(folder)
            folder.cached.unlink(missing_ok=True)
            if listing is None:
                rebuild |= {folder.address} - survey.blocked
            else:
                folder.cached.parent.mkdir(parents=True, exist_ok=True)
                with atomic(folder.cached) as temporary:
                    temporary.write_bytes(listing)
                    temporary.chmod(READ_ONLY)
        elif folder.rebuildable:
            checkout[folder.out.fs_path] = folder.out  # removes unrecorded files

    def intact(file: RecordedFile, path: Path | None) -> bool:
        return file.path not in survey.invalid and survey.matches(path, file.oid)

    for file in survey.files:  # first: other files may be the same object
        if file.cached and intact(file, file.path) and not intact(file, file.cached):
            _cache(file)
            survey.hashes[file.cached] = file.oid
    for file in survey.files:
        here, there = intact(file, file.path), intact(file, file.cached)
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
        if not survey.matches(path, oid):
            path.unlink(missing_ok=True)
    check_out(checkout.values())  # skips outputs of which another part is rebuilt
    return rebuild


def forget_records(repository: OpenRepository, survey: Survey) -> set[str]:
    """Remove the records of outputs that were made from other inputs; return the stages to run again."""
    wrong = survey.misrecorded.keys() - survey.blocked
    for address, path, _ in list(records(repository, ())):
        if address in wrong:
            repository.lockfiles.remove(path, address.rpartition(":")[2])
    repository.lockfiles.flush()
    return wrong


def remove_dead_runs(repository: OpenRepository, bad: set[str]) -> None:
    """Remove saved runs that refer to bad objects that are still missing: DVC would look no further."""
    gone = {oid for oid in bad if not repository.object_path(oid).exists()}
    for path in saved_runs(repository.repo) if gone else ():
        if not gone.isdisjoint(hashes_in(outputs_of(read_entry(path)))):
            remove_saved_run(path)


def _cache(file: RecordedFile) -> None:
    """Copy an intact file from the workspace into the cache, replacing the cached one."""
    assert file.cached is not None
    file.cached.parent.mkdir(parents=True, exist_ok=True)
    with atomic(file.cached) as temporary:
        shutil.copyfile(file.path, temporary)
        if file_hash(temporary, file.hash_name) != file.oid:
            raise ObjectFolderError(f"{file.path} changed while it was read; verify again")
        temporary.chmod(READ_ONLY)
