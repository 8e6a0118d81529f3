"""Read and write surfaces as PLY."""

from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from objectfolder.base.errors import ObjectFolderError
from objectfolder.mesh.topology import Mesh


def write_surface(path: str | Path, surface: Mesh) -> None:
    """Write vertices and faces as binary PLY."""
    mesh = trimesh.Trimesh(*surface, process=False)
    data: Any = mesh.export(file_type="ply", vertex_normal=False)
    Path(path).write_bytes(data)


def read_surface(path: str | Path) -> Mesh:
    """Read vertices (V, 3) and faces (F, 3) of a surface, unit frame.

    Raises
    ------
    ObjectFolderError
        If the file is missing or not a mesh.
    """
    if not Path(path).is_file():
        raise ObjectFolderError(f"{path} does not exist; build it with `objectfolder build`")
    try:
        mesh = trimesh.load_mesh(path, process=False)
        return np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64)
    except Exception as error:  # the parser raises anything
        raise ObjectFolderError(f"{path} is damaged ({error}); delete it and rebuild") from error
