"""Load a mesh with its appearance from any supported file format, and list the files that it refers to."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.io import STRAY, content_hint
from objectfolder.mesh.normals import replace_bad_normals
from objectfolder.mesh.reading.bake import join
from objectfolder.mesh.reading.files import find_referenced
from objectfolder.mesh.reading.gltf import read_gltf, uris
from objectfolder.mesh.reading.mtl import read_library, texture_path, textures
from objectfolder.mesh.reading.obj import mtl_names, read_obj
from objectfolder.mesh.reading.off import read_off
from objectfolder.mesh.reading.parts import MeshContent, MeshPart
from objectfolder.mesh.reading.ply import ply_textures, read_ply
from objectfolder.mesh.reading.stl import read_stl
from objectfolder.mesh.textured import TexturedMesh, z_up

READERS: dict[str, Callable[[Path], MeshContent]] = {
    ".obj": read_obj,
    ".glb": read_gltf,
    ".gltf": read_gltf,
    ".ply": read_ply,
    ".stl": read_stl,
    ".off": read_off,
}
FORMATS = tuple(READERS)  #: suffixes of supported mesh files
AS_STORED = 1 << 16  #: texture size of a mesh that `normalize` wrote: no texture is larger
MAX_REPEATS = 1e9  # of a texture, from its origin to a corner; single precision holds no place beyond
MAX_REACH = 1e30  # largest coordinate in any unit; keeps products finite
# First bytes of files that carry a wrong suffix.
BEGINNINGS = {
    b"glTF": "a .glb",
    b"ply": "a .ply",
    b"OFF": "an .off",
    b"PK\x03\x04": "a .zip archive",
    **STRAY,
}


def default_up(path: str | Path) -> str:
    """Return the default up axis: ``y`` for glTF (by its standard), ``z`` for other formats."""
    return "y" if Path(path).suffix.lower() in (".glb", ".gltf") else "z"


def load_mesh(path: str | Path, up: str = "z", texture_size: int = 1024) -> TexturedMesh:
    """Load a mesh, rotate it z up, and bake its appearance into one texture or vertex colours.

    Vertex normals of the file are kept; bad ones are replaced by face normals, see
    `objectfolder.mesh.normals.replace_bad_normals`.

    Parameters
    ----------
    path : path
        ``.obj`` (with ``.mtl`` and textures beside it), ``.glb``, ``.gltf``, ``.ply``, ``.stl`` or ``.off``.
    up : {"y", "z"}
        The source's up axis.
    texture_size : int
        Longest side of the texture, pixels.

    Raises
    ------
    ObjectFolderError
        If the file, or one it refers to, is missing or unreadable; if its format is unsupported; or if it has
        no faces, face indices out of range, or vertices that are not finite or all coincide.
    """
    path = Path(path)
    if not path.is_file():
        raise ObjectFolderError(f"mesh file {path} does not exist; give the path of an existing mesh")
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        formats = ", ".join(FORMATS)
        raise ObjectFolderError(f"{path}: format {path.suffix!r} is not one of {formats}; convert the mesh")
    if up not in ("y", "z"):
        raise ObjectFolderError(f"{path}: up axis {up!r} is neither 'y' nor 'z'")
    source = _read(path, reader)
    parts = [part for part in source.parts if len(part.faces)]
    if not parts:
        left_out = f" ({'; '.join(source.notes)})" if source.notes else ""
        raise ObjectFolderError(
            f"{path} holds no faces; expected a triangle mesh{left_out}{_looks_like(path)}"
        )
    for part in parts:
        _check(path, part)
    used = np.concatenate([part.vertices[part.used] for part in parts])
    bad = ~np.isfinite(used).all(1)
    if bad.any():
        raise ObjectFolderError(f"{path}: {bad.sum()} of its vertices are NaN or infinite; repair the mesh")
    reach, size = np.abs(used).max(), np.ptp(used, axis=0).max()
    if reach > MAX_REACH:
        raise ObjectFolderError(
            f"{path}: a coordinate of its vertices is {reach:.3g}, expected at most {MAX_REACH:g}; repair "
            "the mesh"
        )
    if size <= 1 / MAX_REACH:
        raise ObjectFolderError(
            f"{path}: all of its vertices coincide; expected a solid object: export it again"
        )
    appearance = _source_report(parts)
    mesh, notes = join([_finite(part) for part in parts], texture_size, str(path))
    bad = 0.0
    if mesh.normals is not None:
        corners, bad = replace_bad_normals(mesh.vertices, mesh.faces, mesh.normals)
        mesh = replace(mesh, normals=None) if corners is None else mesh.with_normals(corners)
        if corners is None:
            notes.append(
                f"vertex normals left out: {bad:.0%} of them are zero or point against their faces' winding"
            )
    appearance |= {"normals_bad_fraction": bad, "notes": [*source.notes, *notes]}
    mesh = replace(mesh, source=appearance)
    return mesh.rotate(z_up) if up == "y" else mesh


def _read(path: Path, reader: Callable[[Path], MeshContent]) -> MeshContent:
    if path.stat().st_size == 0:
        raise ObjectFolderError(f"{path} cannot be read as a mesh: it is empty; export it again")
    try:
        with np.errstate(all="ignore"):  # values are checked later
            return reader(path)
    except ObjectFolderError as error:
        hint = _looks_like(path)
        if not hint or hint in str(error):
            raise
        raise ObjectFolderError(f"{error}{hint}") from error
    except Exception as error:  # the format's parser raises anything
        reason = str(error) or type(error).__name__
        raise ObjectFolderError(f"{path} cannot be read as a mesh: {reason}{_looks_like(path)}") from error


def _looks_like(path: Path) -> str:
    others = {start: kind for start, kind in BEGINNINGS.items() if not kind.endswith(path.suffix.lower())}
    return content_hint(path, others)


def _check(path: Path, part: MeshPart) -> None:
    low, high, count = part.faces.min(), part.faces.max(), len(part.vertices)
    if low < 0 or high >= count:
        raise ObjectFolderError(
            f"{path}: its faces use vertices {low} to {high}, but there are {count}; export the mesh again"
        )
    attributes = {
        "texture coordinates": part.uv,
        "vertex colours": part.colors,
        "vertex normals": part.normals,
    }
    for what, values in attributes.items():
        if values is not None and len(values) != count:
            raise ObjectFolderError(
                f"{path}: {len(values)} {what} for {count} vertices; export the mesh again"
            )


def _finite(part: MeshPart) -> MeshPart:
    """Replace values that are not finite by zeros, and clip vertex colours to [0, 1]."""
    uv = None if part.uv is None else np.where(np.abs(part.uv) < MAX_REPEATS, part.uv, 0)
    vertices = np.where(np.isfinite(part.vertices).all(1, keepdims=True), part.vertices, 0)
    colors = None if part.colors is None else np.nan_to_num(np.clip(part.colors, 0, 1))
    normals = None
    if part.normals is not None:
        normals = np.where(np.isfinite(part.normals).all(1, keepdims=True), part.normals, 0)
    return replace(part, vertices=vertices, uv=uv, colors=colors, normals=normals)


def _source_report(parts: Sequence[MeshPart]) -> dict[str, Any]:
    """Count materials and faces with unusable texture coordinates."""
    count = sum(len(part.faces) for part in parts)
    textured = [p for p in parts if p.material.image is not None and p.uv is not None]
    corners = np.concatenate([np.zeros((0, 3, 2)), *(p.uv[p.faces] for p in textured if p.uv is not None)])
    finite = np.isfinite(corners).all((1, 2))
    edges = np.where(finite[:, None, None], corners[:, 1:] - corners[:, :1], 0)
    area = edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0]
    sides = [max(p.material.image.size) for p in textured if p.material.image is not None]
    large = np.repeat([side > 1 for side in sides], [len(p.faces) for p in textured]).astype(bool)
    outside = finite & ((corners < 0) | (corners > 1)).any((1, 2))
    return {
        "materials": len(dict.fromkeys(part.material for part in parts)),
        "source_texture_size": max(sides, default=0),
        "uv_degenerate_fraction": float((large & finite & (area == 0)).sum() / count),
        "uv_outside_fraction": float(outside.sum() / count),
        "uv_not_finite_fraction": float((~finite).sum() / count),
    }


def references(mesh: Path) -> Iterator[PurePosixPath]:
    """Yield the paths of the files that a mesh refers to, relative to its folder, as `find_referenced` does.

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
            library = find_referenced(mesh, name)
            yield library
            for _, texture in textures(read_library(mesh, library)):
                with suppress(ObjectFolderError):  # outside: no face may need it, which the reader knows
                    yield texture_path(mesh, library.parent, texture)
    elif suffix == ".ply":
        for name in ply_textures(mesh.read_bytes()):
            yield find_referenced(mesh, name, any_case=True)
    elif suffix in (".gltf", ".glb"):
        for uri in uris(mesh):
            yield find_referenced(mesh, uri, any_case=True)
