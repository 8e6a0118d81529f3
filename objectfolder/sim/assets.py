"""Assets of many meshes: each in a process of its own, and again only if something changed."""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from objectfolder.base.errors import ObjectFolderError, shortened
from objectfolder.base.io import read_json
from objectfolder.base.yamlfile import is_yaml_name
from objectfolder.engine.process import in_processes
from objectfolder.sim.asset import REPORT, candidate_asset, inputs_digest
from objectfolder.sim.hulls import MAX_HULLS
from objectfolder.workspace.examine import Candidate
from objectfolder.workspace.objects import object_files


@dataclass(frozen=True)
class AssetOptions:
    """What all assets of a run share."""

    out: Path  #: folder of their folders
    formats: tuple[str, ...]
    max_hulls: int = MAX_HULLS
    unit: str = "m"
    bridge: str = "all"


@dataclass(frozen=True)
class AssetOutcome:
    """What became of a mesh."""

    candidate: Candidate
    report: dict[str, Any] | None = None  #: content of ``asset.json``
    refusal: str = ""  #: why there is no asset
    made: bool = False  #: whether it was made now; else it was there
    seconds: float = 0.0  #: of CPU time


def make_asset(candidate: Candidate, options: AssetOptions) -> AssetOutcome:
    """Write the asset of a mesh unless it is there; a mesh that cannot become one gives a refusal."""
    start = time.process_time()
    try:
        place = options.out / candidate.key
        inputs = "" if candidate.refusal is not None else _inputs(candidate, options)
        found = _present(place, inputs)
        if found is None:
            made = candidate_asset(candidate, options.unit, options.bridge)
            made.write(options.out, options.formats, options.max_hulls, inputs)
            found = read_json(place / REPORT)
            return AssetOutcome(candidate, found, made=True, seconds=time.process_time() - start)
        return AssetOutcome(candidate, found)
    except ObjectFolderError as error:
        refusal = str(error)
    except Exception as error:  # whatever one mesh raises, the others are made
        reason = f"{type(error).__name__}: {shortened(error, 200)}"
        refusal = f"{candidate.mesh} cannot become an asset ({reason})"
    return AssetOutcome(candidate, refusal=refusal, seconds=time.process_time() - start)


def make_assets(
    candidates: Sequence[Candidate], options: AssetOptions, jobs: int = 1
) -> Iterator[AssetOutcome]:
    """Write the assets of meshes, ``jobs`` at a time; yield outcomes in the order in which they are done."""
    if jobs == 1 or len(candidates) == 1:
        yield from (make_asset(candidate, options) for candidate in candidates)
    else:
        yield from in_processes(make_asset, [(candidate, options) for candidate in candidates], jobs)


def _inputs(candidate: Candidate, options: AssetOptions) -> str:
    """Return the digest of all that an asset depends on."""
    files = {
        f"{number}/{name}": path
        for number, mesh in enumerate((candidate.mesh, *candidate.others))
        for name, path in object_files(mesh).items()
    }
    if is_yaml_name(candidate.material or ""):
        files["material"] = Path(candidate.material or "")
    plain = replace(candidate, mesh=Path(), others=(), licence="", author="", source="")
    return inputs_digest(files, (plain, replace(options, out=Path())))


def _present(place: Path, inputs: str) -> dict[str, Any] | None:
    """Return the report of an asset that is there; None if nothing is.

    Raises ObjectFolderError if what is there was made from something else.
    """
    if not inputs or not place.exists():
        return None
    found = read_json(place / REPORT) if (place / REPORT).is_file() else {}
    if isinstance(found, dict) and found.get("inputs") == inputs:
        return found
    raise ObjectFolderError(
        f"{place} exists already, made from another mesh, with other options or by another version; delete "
        "it to make it again, or choose another folder with --out"
    )
