"""Download a model from Poly Haven: a glTF and the files that it refers to."""

import hashlib
import json
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Any

from objectfolder.base.checks import is_web_address
from objectfolder.base.download import MAX_DOWNLOAD, ProgressFactory, download_to
from objectfolder.base.errors import ObjectFolderError, quoted
from objectfolder.hub.fetch.archive import safe_path

MAX_LIST = 1 << 24  #: bytes of a list of files


def download_polyhaven(url: str, resolution: str, into: Path, part: Path, progress: ProgressFactory) -> None:
    """Download the glTF of a model and the files that it refers to.

    ``url``: file list of the model in the Poly Haven API (``/files/{id}``): JSON, in which
    ``gltf.<resolution>.gltf`` has ``url``, ``size``, ``md5`` and ``include``, a mapping from the paths that
    the glTF refers to, to ``url``, ``size`` and ``md5``; ``resolution``: of the textures, such as ``1k``;
    ``into``: directory for the files; ``part``: prefix of the paths of unfinished downloads; ``progress``: as
    in `download_to`. Raises ObjectFolderError if a download fails or is damaged, or the list is malformed.
    """
    index = into.with_name("files.json")
    download_to(index, url, part.with_name(f"{part.name}.index.part"), progress, MAX_LIST)
    files = _files(index, url, resolution)
    for number, (name, (address, size, md5)) in enumerate(sorted(files.items())):
        download_to(into / name, address, part.with_name(f"{part.name}.{number}.part"), progress, size)
        with (into / name).open("rb") as stream:
            actual = hashlib.file_digest(stream, partial(hashlib.md5, usedforsecurity=False)).hexdigest()
        if actual != md5:
            raise ObjectFolderError(f"{address} is damaged: its MD5 is {actual}, {url} says {md5}; try again")


def _files(index: Path, url: str, resolution: str) -> dict[str, tuple[str, int, str]]:
    """Return URL, size and MD5 by path; the list is untrusted, so paths, URLs and sizes are checked."""
    try:
        gltf: dict[str, Any] = json.loads(index.read_text())["gltf"][resolution]["gltf"]
        files = {PurePosixPath(gltf["url"]).name: gltf, **gltf.get("include", {})}
        result = {}
        for name, file in files.items():
            size = min(int(file["size"]), MAX_DOWNLOAD)
            result[str(safe_path(name, url))] = str(file["url"]), size, str(file["md5"])
    except ObjectFolderError:
        raise
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        absent = f"{url} lists no glTF at {resolution} in the format of the Poly Haven API"
        advice = f"({type(error).__name__}: {error}); check the list, and `resolution` in the catalogue"
        raise ObjectFolderError(f"{absent} {advice}") from error
    for name, (address, *_) in result.items():
        if not is_web_address(address):
            raise ObjectFolderError(f"{url}: {name} is at {quoted(address)}, expected http:// or https://")
    return result
