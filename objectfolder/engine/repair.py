"""Restore bad files from the cache or the workspace, whichever has an intact copy."""

import shutil
from pathlib import Path
from typing import Any

from objectfolder.engine.dvc.recorded import READ_ONLY, RecordedFile, check_out, file_hash, records
from objectfolder.engine.dvc.repository import OpenRepository
from objectfolder.engine.dvc.savedruns import remove_saved_run, saved_outputs, saved_runs
from objectfolder.engine.survey import Survey
from objectfolder.errors import ObjectFolderError
from objectfolder.io import atomic


def restore_files(survey: Survey) -> set[str]:
    """Restore files from intact copies and remove bad ones.

    Every step is a removal of a bad file or one rename, so that an interrupted repair loses nothing intact.

    Returns
    -------
    set of str
        Addresses of the stages to run again.
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
    gone = [oid for oid in bad if not repository.object_path(oid).exists()]
    for path in saved_runs(repository.repo) if gone else ():
        text = saved_outputs(path.read_text(errors="replace"))
        if any(f"md5: {oid}\n" in text for oid in gone):
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
