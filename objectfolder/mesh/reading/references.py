"""Files that a mesh file refers to: material libraries, textures, buffers."""

from collections.abc import Iterator
from pathlib import Path, PurePosixPath

from objectfolder.mesh.reading.files import read_referenced, referenced_path
from objectfolder.mesh.reading.gltf import uris
from objectfolder.mesh.reading.mtl import existing_name, textures
from objectfolder.mesh.reading.obj import mtl_names
from objectfolder.mesh.reading.polygons import ply_textures


def references(mesh: Path) -> Iterator[PurePosixPath]:
    """Yield the paths of the files that a mesh refers to, relative to its folder.

    An ``.mtl``, which is read after it was yielded, is followed by the textures it names.

    Raises
    ------
    ObjectFolderError
        If one lies outside the mesh's folder, an ``.mtl`` does not exist, or a glTF file is not valid.
    """
    suffix = mesh.suffix.lower()
    if suffix == ".obj":
        for library in mtl_names(mesh.read_text("utf-8-sig", errors="replace")):
            yield referenced_path(mesh, library)
            for _, texture in textures(read_referenced(mesh, library).decode("utf-8-sig", errors="replace")):
                yield referenced_path(mesh, existing_name(mesh, texture))
    elif suffix == ".ply":
        for name in ply_textures(mesh.read_bytes()):
            yield referenced_path(mesh, name)
    elif suffix in (".gltf", ".glb"):
        for uri in uris(mesh):
            yield referenced_path(mesh, uri)
