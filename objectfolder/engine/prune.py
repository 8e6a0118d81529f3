"""Remove what was built of objects that are no longer in ``params.yaml``."""

import json
import os
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dvc.exceptions import DvcException
from dvc.repo import Repo

from objectfolder.engine.dvc import emit
from objectfolder.engine.dvc.lockfile import LockFiles
from objectfolder.engine.dvc.repository import held, read_params
from objectfolder.engine.dvc.savedruns import entries, outputs, remove
from objectfolder.engine.failures import LOGS
from objectfolder.errors import ObjectFolderError
from objectfolder.workspace.layout import Benchmarks, Build

LOCK = "dvc.lock"
_OID = re.compile(r"\b[0-9a-f]{32}(?:\.dir)?\b")


@dataclass(frozen=True)
class Waste:
    """What can go.

    Parameters
    ----------
    keys : tuple of str
        Objects that are no longer in ``params.yaml``.
    addresses : tuple of str
        Their entries in ``dvc.lock``.
    files : dict of str to tuple of Path
        Artifacts, metrics and logs by object.
    cached : dict of str to tuple of Path
        Cached objects by object; one that several of them share is with the first.
    runs : tuple of Path
        Their saved runs.
    left : tuple of str
        What stays, and why.
    """

    keys: tuple[str, ...]
    addresses: tuple[str, ...]
    files: dict[str, tuple[Path, ...]]
    cached: dict[str, tuple[Path, ...]]
    runs: tuple[Path, ...]
    left: tuple[str, ...]

    @staticmethod
    def size(paths: Iterable[Path]) -> int:
        """Bytes of files."""
        return sum(path.lstat().st_size for path in paths)

    @property
    def bytes(self) -> int:
        """Bytes of everything that can go."""
        groups = (*self.files.values(), *self.cached.values(), self.runs)
        return sum(self.size(paths) for paths in groups)


def survey(root: str | Path = ".") -> Waste:
    """Find what was built of objects that are no longer there; changes nothing.

    Raises
    ------
    ObjectFolderError
        If the workspace is busy or cannot be read.
    """
    root = Path(root).resolve()
    with held(root) as (repo, lockfiles):
        try:
            return _survey(repo, root, lockfiles)
        except DvcException as error:
            raise ObjectFolderError(f"DVC cannot read {root}: {error}") from error


def prune(waste: Waste, root: str | Path = ".") -> None:
    """Remove what `survey` found, if that is still what it finds.

    What the lock file names goes before its entries do: a prune that was killed is finished by the next.

    Raises
    ------
    ObjectFolderError
        If the workspace is busy, or has changed since the survey.
    """
    root = Path(root).resolve()
    with held(root) as (repo, lockfiles):
        if _survey(repo, root, lockfiles) != waste:
            raise ObjectFolderError("the workspace has changed since it was examined; prune again")
        for path in (p for group in (waste.files, waste.cached) for paths in group.values() for p in paths):
            path.unlink(missing_ok=True)
        for entry in waste.runs:
            remove(entry)
        for key in waste.keys:
            _remove_empty(Build(key, root).dir)
            _remove_empty(Benchmarks(root / "benchmarks").observations(key))
        for address in waste.addresses:
            lockfiles.remove(root / LOCK, address)
        lockfiles.flush()


def _survey(repo: Repo, root: Path, lockfiles: LockFiles) -> Waste:
    params = read_params(root)
    addresses = {stage.addressing for stage in repo.index.stages}
    living = {str(key) for group in ("objects", "procedural") for key in params.get(group) or {}}
    living |= {address.partition("@")[2] for address in addresses}  # splits of benchmarks
    stages = lockfiles.stages(root / LOCK)
    dead = {
        a: e for a, e in stages.items() if a not in addresses and a.partition("@")[2] not in {"", *living}
    }
    keys = {address.partition("@")[2] for address in dead}
    keys |= {path.stem.partition("@")[2] for path in (root / LOGS).glob("*@*.log")} - living
    alive = {address: entry for address, entry in stages.items() if address not in dead}

    runs, saved = [], []
    texts = [emit.dumps(alive), *(Path(f).read_text() for f in _other_files(repo, root))]
    pattern = _of_keys(keys)
    for path in entries(repo) if keys else ():
        text = path.read_text(errors="replace")
        owner = pattern.search(outputs(text))
        if owner:
            runs.append(path)
            saved.append((next(filter(None, owner.groups())), outputs(text)))
        else:
            texts.append(text)
    kept = set(_with_members(repo, (oid for text in texts for oid in _OID.findall(text))))
    outs = [
        (address.partition("@")[2], emit.dumps({"outs": entry.get("outs", [])}))
        for address, entry in dead.items()
    ]
    cached: dict[str, set[Path]] = {key: set() for key in keys}
    taken = set(kept)
    left = []
    if Path(repo.cache.local_cache_dir).is_relative_to(root):
        for key, text in sorted([*outs, *saved]):
            for oid in set(_with_members(repo, _OID.findall(text))) - taken:
                taken.add(oid)
                path = Path(repo.cache.local.oid_to_path(oid))
                if path.is_file():
                    cached[key].add(path)
    elif keys:
        left.append(
            f"the cache {repo.cache.local_cache_dir}: it may serve other workspaces (`dvc gc` cleans it)"
        )
        runs = []
    files = {
        key: _files(root, key, [e for a, e in dead.items() if a.partition("@")[2] == key]) for key in keys
    }
    left += [note for key in sorted(keys) for note in _left(root, key, files[key])]
    return Waste(
        keys=tuple(sorted(keys)),
        addresses=tuple(sorted(dead)),
        files={key: files[key] for key in sorted(keys)},
        cached={key: tuple(sorted(cached[key])) for key in sorted(keys)},
        runs=tuple(sorted(runs)),
        left=tuple(left),
    )


def _files(root: Path, key: str, dead: list[dict[str, Any]]) -> tuple[Path, ...]:
    """Artifacts, pictures of inspections, metrics and logs of an object, as far as they exist."""
    build = Build(key, root)
    found = {*build.artifacts(), build.solved_modes, build.metrics, *(root / LOGS).glob(f"*@{key}.*")}
    found |= set(build.inspections.rglob("*"))
    homes = (build.dir, Benchmarks(root / "benchmarks").observations(key))
    for out in (root / out["path"] for entry in dead for out in entry.get("outs", [])):
        if any(out.is_relative_to(home) for home in homes):
            found |= {out, *out.rglob("*")}
    return tuple(sorted(path for path in found if path.is_file() or path.is_symlink()))


def _left(root: Path, key: str, files: tuple[Path, ...]) -> Iterator[str]:
    source = root / "data/objects" / key
    if source.with_name(f"{key}.dvc").exists():
        yield f"data/objects/{key}: its source; `dvc remove --outs data/objects/{key}.dvc` removes it"
    elif source.exists():
        yield f"data/objects/{key}: its source; remove the folder if you do not need it"
    others = [path for path in (root / "build" / key).rglob("*") if path.is_file() and path not in set(files)]
    if others:
        names = ", ".join(os.path.relpath(path, root) for path in others[:3])
        yield f"{names}{' ...' if len(others) > 3 else ''}: not written by the pipeline"


def _other_files(repo: Repo, root: Path) -> list[str]:
    """.dvc files and lock files but the workspace's own."""
    paths = {str(stage.path) for stage in repo.index.stages}
    paths = {path if path.endswith(".dvc") else str(Path(path).with_suffix(".lock")) for path in paths}
    return [path for path in sorted(paths) if path != str(root / LOCK) and Path(path).exists()]


def _of_keys(keys: set[str]) -> re.Pattern[str]:
    """Outputs of these objects in an entry of the run cache."""
    names = "|".join(map(re.escape, sorted(keys))) or "(?!)"
    folders = "build|data/objects|benchmarks/observations"
    return re.compile(rf"^- path: (?:(?:{folders})/({names})(?:/|$)|metrics/({names})\.json$)", re.MULTILINE)


def _with_members(repo: Repo, oids: Iterable[str]) -> Iterator[str]:
    """The hashes, and those of the files in directories."""
    for oid in oids:
        yield oid
        if oid.endswith(".dir"):
            try:
                members = json.loads(Path(repo.cache.local.oid_to_path(oid)).read_text())
            except (OSError, ValueError):
                continue
            yield from (member["md5"] for member in members)


def _remove_empty(folder: Path) -> None:
    """Remove a folder and those in it, as far as they are empty."""
    for path in sorted((folder, *folder.rglob("*")), reverse=True):
        if path.is_dir() and not any(path.iterdir()):
            path.rmdir()
