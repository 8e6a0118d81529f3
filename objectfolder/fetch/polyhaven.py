"""Download a model from Poly Haven: a glTF and the files that it includes, each at its own address."""

import hashlib
import json
from pathlib import Path, PurePosixPath
from typing import Any

from objectfolder.errors import ObjectFolderError
from objectfolder.fetch.archive import safe_path
from objectfolder.fetch.download import Reporter, download_to


def download_polyhaven(url: str, resolution: str, into: Path, part: Path, reporter: Reporter) -> None:
    """Download the glTF of a model and what it includes.

    Parameters
    ----------
    url : str
        Files list of the model in the Poly Haven API (``/files/{id}``): JSON, in which
        ``gltf.<resolution>.gltf`` has ``url``, ``md5`` and ``include``, a mapping from the paths that the
        glTF refers to, to ``url`` and ``md5``.
    resolution : str
        Of the textures, such as ``1k``.
    into : Path
        Directory for the files.
    part : Path
        Unfinished downloads are kept in files whose names start so.
    reporter : callable
        As in `download_to`.

    Raises
    ------
    ObjectFolderError
        If a download fails or is damaged, or the list is not of that form.
    """
    index = into.with_name("files.json")
    download_to(index, url, part.with_name(f"{part.name}.index.part"), reporter)
    files = _files(index, url, resolution)
    for number, (name, (address, md5)) in enumerate(sorted(files.items())):
        download_to(into / name, address, part.with_name(f"{part.name}.{number}.part"), reporter)
        actual = hashlib.md5((into / name).read_bytes(), usedforsecurity=False).hexdigest()
        if actual != md5:
            raise ObjectFolderError(f"{address} is damaged: its MD5 is {actual}, {url} says {md5}; try again")


def _files(index: Path, url: str, resolution: str) -> dict[str, tuple[str, str]]:
    """Addresses and MD5 by path. The list is a stranger's: paths stay inside, addresses are of the web."""
    try:
        gltf: dict[str, Any] = json.loads(index.read_text())["gltf"][resolution]["gltf"]
        files = {PurePosixPath(gltf["url"]).name: gltf, **gltf.get("include", {})}
        result = {
            str(safe_path(name, url)): (str(file["url"]), str(file["md5"])) for name, file in files.items()
        }
    except ObjectFolderError:
        raise
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise ObjectFolderError(
            f"{url} lists no glTF at {resolution} as the Poly Haven API does "
            f"({type(error).__name__}: {error}); look at it, and at `resolution` in the catalogue"
        ) from error
    for name, (address, _) in result.items():
        if not address.startswith(("http://", "https://")):
            raise ObjectFolderError(f"{url}: {name} is at {address!r}, expected http:// or https://")
    return result
