"""Fetch objects of a catalogue: download, verify, extract, and add each as ``objectfolder add`` does."""

import logging
import os
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory
from urllib.parse import urlsplit

import numpy as np
from ruamel.yaml import YAML

from objectfolder.base.disk import refuse_links
from objectfolder.base.download import (
    DownloadError,
    ProgressFactory,
    UnreachableError,
    download_to,
    no_progress,
)
from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.io import check_output, file_digest, write_text
from objectfolder.base.locks import exclusive
from objectfolder.base.text import visible
from objectfolder.base.yamlfile import read_yaml
from objectfolder.engine.dvc.repository import track
from objectfolder.hub.fetch.archive import extract
from objectfolder.hub.fetch.catalogue import Catalogue
from objectfolder.hub.fetch.files import collect, find_local, find_mesh
from objectfolder.hub.fetch.polyhaven import download_polyhaven
from objectfolder.hub.release.notices import SOURCE
from objectfolder.mesh.reading.load import load_mesh
from objectfolder.mesh.settings import NormalizeConfig
from objectfolder.workspace import params
from objectfolder.workspace.objects import add_mesh

CACHE = Path("build/.fetch")  #: unfinished downloads
SIZE_TOLERANCE = 0.05  #: between the catalogue's size and the mesh's own
_ELSEWHERE = "give another address with --url SOURCE=TEMPLATE, or files of your own with --from DIR"
_log = logging.getLogger(__name__)
CHECKSUMS = Path("data/checksums.yaml")
_HEADER = (
    "# SHA-256 of the files that `objectfolder fetch` has used, recorded at first use. Commit this file.\n"
)


class FetchStatus(StrEnum):
    """Outcome of fetching an object."""

    ADDED = "added"
    PRESENT = "present"
    FAILED = "failed"


@dataclass(frozen=True)
class FetchResult:
    """Result of fetching one object."""

    key: str
    status: FetchStatus
    detail: str  #: message


def fetch_object(
    key: str,
    catalogue: Catalogue,
    directory: Path | None = None,
    accept_changed: bool = False,
    root: Path = Path(),
    progress: ProgressFactory = no_progress,
) -> FetchResult:
    """Fetch one object and add it to the workspace, unless it is present.

    ``directory``: local one to take it from, instead of downloading it; ``accept_changed``: accept files that
    have changed since first use, and record their new checksums; ``root``: workspace; ``progress``: takes the
    name of a file to download and returns the callback for its progress. Raises ObjectFolderError on any
    failure; ``data/`` and ``params.yaml`` are then unchanged.
    """
    if (present := _present(key, root)) is not None:
        return present
    refuse_links(root / CACHE, root)
    check_output(root / CACHE / key)
    waiting = "waiting for another `objectfolder fetch` of this workspace"
    with exclusive(root / CACHE, lambda: _log.warning(waiting)):
        return _present(key, root) or _fetch(key, catalogue, directory, accept_changed, root, progress)


def _present(key: str, root: Path) -> FetchResult | None:
    if key in params.read(root / params.PARAMS_FILE)["objects"]:
        return FetchResult(key, FetchStatus.PRESENT, f"data/objects/{key} is there already")
    return None


def _fetch(
    key: str,
    catalogue: Catalogue,
    directory: Path | None,
    accept_changed: bool,
    root: Path,
    progress: ProgressFactory,
) -> FetchResult:
    home = Path("data/objects") / key
    values = params.read(root / params.PARAMS_FILE)
    if os.path.lexists(root / home):
        raise ObjectFolderError(f"{home} exists, but params.yaml has no such object; remove the folder")
    entry, source = catalogue.objects[key], catalogue.source(key)
    lock = root / CHECKSUMS
    recorded = read_checksums(lock).get(key, {})
    for left in (root / CACHE).glob(f"{key}.*/"):  # by a fetch that was killed
        shutil.rmtree(left, ignore_errors=True)
    with TemporaryDirectory(dir=root / CACHE, prefix=f"{key}.") as folder:
        scratch = Path(folder)
        try:
            tree, origin, archive = _obtain(key, catalogue, directory, scratch, root / CACHE, progress)
        except DownloadError as error:
            error.args = (f"{error}; or {_ELSEWHERE}",)
            raise
        try:
            mesh, files = collect(find_mesh(tree, source), tree, scratch / "object")
            used = {archive.name: archive} if archive else files
            digests = {name: file_digest(path) for name, path in used.items()}
            if not accept_changed:
                check_unchanged(recorded, digests, key, lock)
            notice = scratch / SOURCE
            notice.write_text(source_text(key, catalogue, origin), encoding="utf-8")
            most = params.settings(NormalizeConfig, values, root / params.PARAMS_FILE).texture_size
            own_size = float(np.ptp(load_mesh(mesh, texture_size=most).bounds, axis=0).max())
            # The source's up axis applies to its own format only.
            up = source.up if mesh.suffix.lower() == Path(source.mesh).suffix else None
            add_mesh(mesh, key, entry.material, entry.scale, up, root, [notice], mass=entry.mass, track=track)
        except (ObjectFolderError, OSError) as error:
            message = str(error).replace(f"{scratch / 'object'}/", "")
            raise ObjectFolderError(f"{message} (from {origin})") from error
    record_checksums(lock, key, digests)
    detail = f"{entry.material}, {entry.scale:g} m" + (f", {entry.mass:g} kg" if entry.mass else "")
    if abs(own_size / entry.scale - 1) > SIZE_TOLERANCE:
        detail += f" (scaled: the mesh itself measures {own_size:.3g} m)"
    return FetchResult(key, FetchStatus.ADDED, detail + (f"; {entry.note}" if entry.note else ""))


def fetch_all(
    keys: Sequence[str],
    catalogue: Catalogue,
    directory: Path | None = None,
    accept_changed: bool = False,
    root: Path = Path(),
    progress: ProgressFactory = no_progress,
    on_result: Callable[[FetchResult], None] = lambda result: None,
) -> list[FetchResult]:
    """Fetch objects one after another; a failure does not stop the others. Otherwise like `fetch_object`.

    A host that cannot be reached is not asked for further objects. ``on_result``: called with each result.
    """
    # Without a workspace, raises once instead of once per object.
    present = params.read(root / params.PARAMS_FILE)["objects"]
    unreachable: dict[str, UnreachableError] = {}
    results = []
    for key in keys:
        host = urlsplit(catalogue.url(key)).netloc
        try:
            if host in unreachable and key not in present:
                raise unreachable[host]
            result = fetch_object(key, catalogue, directory, accept_changed, root, progress)
        except (ObjectFolderError, OSError) as error:
            if isinstance(error, UnreachableError):
                unreachable[error.host] = error
            result = FetchResult(key, FetchStatus.FAILED, str(error))
        except Exception as error:  # readers may raise anything on unexpected content
            result = FetchResult(key, FetchStatus.FAILED, f"unexpected {error!r}")
        on_result(result)
        results.append(result)
    return results


def source_text(key: str, catalogue: Catalogue, origin: str) -> str:
    """Return the notice stored with a mesh: origin, licence, attribution and changes."""
    entry, source = catalogue.objects[key], catalogue.source(key)
    number = "" if entry.id is None else f", object {entry.id} of ObjectFolder 1.0"
    chosen = [f"Material and size: objectfolder, real objects, version {catalogue.version}"]
    if number:
        chosen = [
            "Name, material and size: ObjectFolder, Gao et al., CoRL 2021, CC BY 4.0",
            "(https://creativecommons.org/licenses/by/4.0/)",
        ]
    chosen[-1] += f"; {entry.note}" if entry.note else ""
    lines = (
        f"{entry.name}{number}",
        "",
        f"Mesh and textures: {source.title}, {catalogue.page(key)}",
        f"Taken from: {origin}",
        f"Licence: {source.licence}",
        f"Attribution: {source.attribution}",
        "Changes: the mesh is renamed; files that it does not refer to are omitted.",
        "",
        *chosen,
        *([f"Mass: {entry.mass:g} kg; {source.masses or source.attribution}"] if entry.mass else []),
    )
    # A line break in a name would begin a line of its own, such as another licence.
    return "".join(f"{visible(line)}\n" for line in lines)


def _obtain(
    key: str,
    catalogue: Catalogue,
    directory: Path | None,
    scratch: Path,
    cache: Path,
    progress: ProgressFactory,
) -> tuple[Path, str, Path | None]:
    """Return the folder with an object's files, where they are from, and their archive if there is one."""
    tree = scratch / "tree"
    if directory is not None:
        found = find_local(directory, catalogue, key)
        if found.is_dir():
            return found, f"the folder {found.name}", None
        extract(found, tree)
        return tree, f"the archive {found.name}", found
    url = catalogue.url(key)
    if catalogue.source(key).kind == "polyhaven":
        download_polyhaven(url, catalogue.source(key).resolution, tree, cache / key, progress)
        return tree, url, None
    archive = scratch / catalogue.archive_name(key)
    download_to(archive, url, cache / f"{key}.part", progress)
    try:
        extract(archive, tree)
    except ObjectFolderError as error:
        raise ObjectFolderError(f"{error} (from {url})") from error
    return tree, url, archive


def read_checksums(path: Path) -> dict[str, dict[str, str]]:
    """Read recorded checksums by object and file name, if there are any; ObjectFolderError if damaged."""
    values = read_yaml(path) if path.exists() else None
    values = {} if values is None else values
    if not isinstance(values, dict) or not all(isinstance(files, dict) for files in values.values()):
        raise ObjectFolderError(f"{path} does not map objects to files and checksums; restore it from git")
    return values


def check_unchanged(recorded: Mapping[str, str], digests: Mapping[str, str], key: str, path: Path) -> None:
    """Raise ObjectFolderError if a file has another checksum than the recorded one; new ones are accepted."""
    for name, digest in digests.items():
        if recorded.get(name, digest) != digest:
            changed = f"{name} of {key} has changed since it was first used"
            digests_of = f"expected SHA-256 {recorded[name]} ({path}), got {digest}"
            raise ObjectFolderError(f"{changed}: {digests_of}; to accept the new file, give --accept-changed")


def record_checksums(path: Path, key: str, digests: Mapping[str, str]) -> None:
    """Record the checksums of an object, replacing those of files with the same names."""
    values = read_checksums(path)
    values[key] = {**values.get(key, {}), **digests}
    yaml = YAML(typ="safe")
    yaml.default_flow_style = False
    yaml.width = 4096
    stream = StringIO()
    yaml.dump({name: dict(sorted(values[name].items())) for name in sorted(values)}, stream)
    write_text(path, _HEADER + stream.getvalue())
