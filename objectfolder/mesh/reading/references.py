"""Files that a mesh file refers to: material libraries, textures, buffers."""

import re
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from urllib.parse import unquote

from objectfolder.mesh.reading.files import referenced_path
from objectfolder.mesh.reading.gltf import read_document
from objectfolder.mesh.reading.obj import mtl_names, textures


def references(mesh: Path) -> Iterator[PurePosixPath]:
    """Yield the paths of the files that a mesh refers to, relative to its folder.

    An ``.mtl``, if it exists, is followed by the textures it names.

    Raises
    ------
    ObjectFolderError
        If one lies outside the mesh's folder.
    """
    suffix = mesh.suffix.lower()
    if suffix == ".obj":
        for library in mtl_names(mesh.read_text(errors="replace")):
            yield referenced_path(mesh, library)
            if (mesh.parent / library).is_file():
                for _, texture in textures((mesh.parent / library).read_text(errors="replace")):
                    yield referenced_path(mesh, texture)
    elif suffix == ".ply":
        header = mesh.read_bytes()[:65536].partition(b"end_header")[0].decode(errors="replace")
        for name in re.findall(r"^comment TextureFile (.+?)\s*$", header, re.MULTILINE):
            yield referenced_path(mesh, name)
    elif suffix in (".gltf", ".glb"):
        document, _ = read_document(mesh)
        for item in document.get("buffers", []) + document.get("images", []):
            uri = item.get("uri", "")
            if uri and not uri.startswith("data:"):
                yield referenced_path(mesh, unquote(uri))
