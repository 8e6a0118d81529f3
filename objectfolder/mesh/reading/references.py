"""Files that a mesh file refers to: material libraries, textures, buffers."""

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path, PurePosixPath

from objectfolder.errors import ObjectFolderError
from objectfolder.mesh.reading.files import referenced_path
from objectfolder.mesh.reading.gltf import uris
from objectfolder.mesh.reading.mtl import read_library, texture_path, textures
from objectfolder.mesh.reading.obj import mtl_names
from objectfolder.mesh.reading.polygons import ply_textures


def references(mesh: Path) -> Iterator[PurePosixPath]:
    """Yield the paths of the files that a mesh refers to, relative to its folder.

    An ``.mtl``, which is read after it was yielded, is followed by the textures that it names, also by those
    that no face needs. They may be missing; one outside the mesh's folder is left out.

    Raises
    ------
    ObjectFolderError
        If another file lies outside the mesh's folder, an ``.mtl`` does not exist, or a glTF file is not
        valid.
    """
    suffix = mesh.suffix.lower()
    if suffix == ".obj":
        for name in mtl_names(mesh):
            library = referenced_path(mesh, name)
            yield library
            for _, texture in textures(read_library(mesh, library)):
                with suppress(ObjectFolderError):  # outside: no face may need it, which the reader knows
                    yield texture_path(mesh, library.parent, texture)
    elif suffix == ".ply":
        for name in ply_textures(mesh.read_bytes()):
            yield referenced_path(mesh, name)
    elif suffix in (".gltf", ".glb"):
        for uri in uris(mesh):
            yield referenced_path(mesh, uri)
