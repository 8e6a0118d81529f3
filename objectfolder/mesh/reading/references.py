"""Files that a mesh file refers to: material libraries, textures, buffers."""

import re
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from urllib.parse import unquote

from objectfolder.mesh.reading.gltf import read_document
from objectfolder.mesh.reading.part import inside


def references(mesh: Path) -> Iterator[PurePosixPath]:
    """Yield the paths of the files that a mesh refers to, relative to its folder.

    Those that an ``.mtl`` names follow its own name, if it is there.

    Raises
    ------
    ObjectFolderError
        If one lies outside the mesh's folder.
    """
    suffix = mesh.suffix.lower()
    if suffix == ".obj":
        for library in mtl_names(mesh.read_text(errors="replace")):
            yield inside(mesh, library)
            if (mesh.parent / library).is_file():
                for _, texture in textures((mesh.parent / library).read_text(errors="replace")):
                    yield inside(mesh, texture)
    elif suffix == ".ply":
        header = mesh.read_bytes()[:65536].partition(b"end_header")[0].decode(errors="replace")
        for name in re.findall(r"^comment TextureFile (.+?)\s*$", header, re.MULTILINE):
            yield inside(mesh, name)
    elif suffix in (".gltf", ".glb"):
        document, _ = read_document(mesh)
        for item in document.get("buffers", []) + document.get("images", []):
            uri = item.get("uri", "")
            if uri and not uri.startswith("data:"):
                yield inside(mesh, unquote(uri))


def mtl_names(obj: str) -> list[str]:
    """Material libraries of the text of an ``.obj``, in order; names may hold spaces."""
    lines = re.findall(r"^mtllib[ \t]+(.+?)\s*$", obj, re.MULTILINE)
    names = [name for line in lines for name in re.findall(r"\S.*?\.mtl(?=\s|$)", line, re.I) or [line]]
    return list(dict.fromkeys(names))


def textures(mtl: str) -> list[tuple[str, str]]:
    """Maps of the text of an ``.mtl``: statement, such as ``map_Kd``, and file name without options."""
    # Options such as `-s 1 1 1` come before the name.
    option = r"^(-\w+(\s+(-?[\d.]+|on|off))*\s+)*"
    maps = re.findall(r"^\s*(map_\w+|bump|disp|decal|norm)\s+(.+?)\s*$", mtl, re.MULTILINE | re.I)
    return [(statement, re.sub(option, "", name)) for statement, name in maps]
