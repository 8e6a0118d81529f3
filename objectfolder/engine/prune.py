"""Remove the artifacts of objects that are no longer in ``params.yaml``."""

import json
import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from objectfolder.base.errors import ObjectFolderError
from objectfolder.engine.dvc.graph import all_stages, dvc_files
from objectfolder.engine.dvc.repository import OpenRepository, open_repository, read_params
from objectfolder.engine.dvc.runcache import hashes_in, outputs_of, read_entry, remove_saved_run, saved_runs
from objectfolder.engine.records import LOGS
from objectfolder.workspace.layout import MODALITIES, Benchmarks, Build
from objectfolder.workspace.stages import OBJECT_TASKS, TASKS

LOCK = "dvc.lock"
BENCHMARKS = "benchmarks"


@dataclass(frozen=True)
class Waste:
    """Files and records to remove."""

    keys: tuple[str, ...]  #: objects that are no longer in ``params.yaml``
    addresses: tuple[str, ...]  #: their entries in ``dvc.lock``
    files: dict[str, tuple[Path, ...]]  #: artifacts, metrics and logs by object
    cached: dict[str, tuple[Path, ...]]  #: cached objects by object; a shared one is listed with the first
    runs: tuple[Path, ...]  #: their saved runs
    left: tuple[str, ...]  #: descriptions of what is kept, with the reason

    @staticmethod
    def size(paths: Iterable[Path]) -> int:
        """Return the total size of files, bytes."""
        return sum(path.lstat().st_size for path in paths)

    @property
    def bytes(self) -> int:
        """Size of all files to remove."""
        groups = (*self.files.values(), *self.cached.values(), self.runs)
        return sum(self.size(paths) for paths in groups)


def survey(root: str | Path = ".") -> Waste:
    """List the artifacts of objects that are no longer in ``params.yaml``; read-only.

    Raises ObjectFolderError if the workspace is busy or cannot be read.
    """
    with open_repository(root) as repository:
        return _survey(repository)


def prune(waste: Waste, root: str | Path = ".") -> None:
    """Remove what `survey` found, if the workspace has not changed since.

    Files are removed before their entries in the lock file, so that the next prune can finish a killed one.
    Raises ObjectFolderError if the workspace is busy, or has changed since the survey.
    """
    with open_repository(root) as repository:
        if _survey(repository) != waste:
            raise ObjectFolderError("the workspace has changed since it was examined; prune again")
        for path in (p for group in (waste.files, waste.cached) for paths in group.values() for p in paths):
            path.unlink(missing_ok=True)
        for entry in waste.runs:
            remove_saved_run(entry)
        for key in waste.keys:
            for folder in (Build(key, repository.root).dir, *_samples(key, repository.root)):
                _remove_empty(folder)
        for address in waste.addresses:
            repository.lockfiles.remove(repository.root / LOCK, address)
        repository.lockfiles.flush()


def _survey(repository: OpenRepository) -> Waste:
    root = repository.root
    params = read_params(root)
    addresses = set(all_stages(repository))
    living = {str(key) for group in ("objects", "procedural") for key in params.get(group) or {}}
    living |= {address.partition("@")[2] for address in addresses}  # splits of benchmarks
    stages = repository.lockfiles.stages(root / LOCK)
    dead = {a: e for a, e in stages.items() if a not in addresses and _key(a) not in {"", *living}}
    keys = {_key(address) for address in dead}
    keys |= {_key(path.stem) for path in (root / LOGS).glob("*@*.log")} - {"", *living}
    alive = {address: entry for address, entry in stages.items() if address not in dead}

    runs: list[Path] = []
    dead_outs = [(_key(address), entry) for address, entry in dead.items()]
    others = (path for path in dvc_files(repository) if path != repository.root / LOCK and path.exists())
    kept = {*hashes_in([*alive.values(), *map(read_entry, others)])}
    for path in saved_runs(repository.repo) if keys else ():
        entry = read_entry(path)
        owner = _owner(entry, keys)
        if owner:
            runs.append(path)
            dead_outs.append((owner, entry))
        else:
            kept |= {*hashes_in(entry)}
    cached: dict[str, set[Path]] = {key: set() for key in keys}
    taken = {*_with_members(repository, kept)}
    left = []
    if repository.owns_cache:
        for key, entry in sorted(dead_outs, key=lambda item: item[0]):
            for oid in {*_with_members(repository, hashes_in(outputs_of(entry)))} - taken:
                taken.add(oid)
                path = repository.object_path(oid)
                if path.is_file():
                    cached[key].add(path)
    elif keys:
        left.append(f"the cache {repository.cache_dir}: other workspaces may use it (`dvc gc` cleans it)")
        runs = []
    files = {key: _files(root, key, [e for a, e in dead.items() if _key(a) == key]) for key in keys}
    left += [note for key in sorted(keys) for note in _left(root, key, files[key])]
    return Waste(
        keys=tuple(sorted(keys)),
        addresses=tuple(sorted(dead)),
        files={key: files[key] for key in sorted(keys)},
        cached={key: tuple(sorted(cached[key])) for key in sorted(keys)},
        runs=tuple(sorted(runs)),
        left=tuple(left),
    )


def _key(address: str) -> str:
    """Return the object of a stage; empty for one of all objects, whose address may name a split."""
    stage, _, key = address.partition("@")
    return "" if stage in TASKS else key


def _files(root: Path, key: str, dead: list[dict[str, Any]]) -> tuple[Path, ...]:
    """List the existing artifacts, inspection pictures, metrics and logs of an object."""
    build, benchmarks = Build(key, root), Benchmarks(root / BENCHMARKS)
    found = {*build.artifacts(), build.solved_modes, *map(build.checkpoint, MODALITIES), build.metrics}
    found |= {*(root / LOGS).glob(f"*@{key}.*"), *build.inspections.rglob("*")}
    found |= {path for task in OBJECT_TASKS for path in benchmarks.results(task, key)}
    homes = (build.dir, *_samples(key, root))
    for out in (root / out["path"] for entry in dead for out in entry.get("outs", [])):
        if any(out.is_relative_to(home) for home in homes):
            found |= {out, *out.rglob("*")}
    return tuple(sorted(path for path in found if path.is_file() or path.is_symlink()))


def _samples(key: str, root: Path) -> tuple[Path, ...]:
    benchmarks = Benchmarks(root / BENCHMARKS)
    return benchmarks.observations(key), benchmarks.close_ups(key), benchmarks.grasps(key)


def _left(root: Path, key: str, files: tuple[Path, ...]) -> Iterator[str]:
    source = root / "data/objects" / key
    if source.with_name(f"{key}.dvc").exists():
        yield f"data/objects/{key}: its source; `dvc remove --outs data/objects/{key}.dvc` removes it"
    elif source.exists():
        yield f"data/objects/{key}: its source; remove the folder if it is no longer needed"
    others = [path for path in (root / "build" / key).rglob("*") if path.is_file() and path not in set(files)]
    if others:
        names = ", ".join(os.path.relpath(path, root) for path in others[:3])
        yield f"{names}{' ...' if len(others) > 3 else ''}: not written by the pipeline"


def _owner(entry: Any, keys: set[str]) -> str:
    """Return the object whose outputs a saved run lists; empty if it is none of ``keys``."""
    owners = (_object_of(PurePosixPath(out["path"])) for out in outputs_of(entry))
    return next((owner for owner in owners if owner in keys), "")


def _object_of(path: PurePosixPath) -> str:
    """Return the object that an output of the pipeline belongs to; empty for one of all objects."""
    match path.parts:
        case ("build", key, *_) | ("data", "objects", key, *_):
            return key
        case ("benchmarks", "observations" | "close_ups" | "grasps", key, *_):
            return key
        case ("metrics", _) if path.suffix == ".json":
            return path.stem
        case ("benchmarks", _):
            task = next((task for task in OBJECT_TASKS if path.name.startswith(f"{task}_")), None)
            return path.stem.removeprefix(f"{task}_") if task else ""
    return ""


def _with_members(repository: OpenRepository, oids: Iterable[str]) -> Iterator[str]:
    for oid in oids:
        yield oid
        if oid.endswith(".dir"):
            try:
                members = json.loads(repository.object_path(oid).read_text())
            except (OSError, ValueError):
                continue
            yield from (member["md5"] for member in members)


def _remove_empty(folder: Path) -> None:
    for path in sorted((folder, *folder.rglob("*")), reverse=True):
        if path.is_dir() and not any(path.iterdir()):
            path.rmdir()
