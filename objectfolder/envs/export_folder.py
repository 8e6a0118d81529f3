"""What all exports of objects as rigid bodies begin with: a new folder, and the body that goes into it."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import trimesh

from objectfolder.disk import new_folder
from objectfolder.envs.body import RigidBody, rigid_body
from objectfolder.envs.hulls import convex_hulls
from objectfolder.objectfile.file import ObjectFile

_NEEDED = 8 * 2**20  # approximate size of a folder with mesh and texture, bytes


@contextmanager
def export_folder(
    file: ObjectFile, out: str | Path, max_hulls: int, hulls: Sequence[trimesh.Trimesh] | None
) -> Iterator[tuple[Path, RigidBody]]:
    """Give a folder to fill, which becomes ``OUT/<key>`` if nothing fails, and the object's rigid body.

    Parameters
    ----------
    file : ObjectFile
    out : path
        Parent of the new folder.
    max_hulls : int
        Of those that are computed.
    hulls : sequence of trimesh.Trimesh, optional
        Default: computed, which takes up to half a minute.

    Raises
    ------
    ObjectFolderError
        If the folder exists already, the file holds no geometry, or an extra is not installed.
    """
    with new_folder(f"{file.key}: export", Path(out) / file.key, _NEEDED, "") as new:
        yield new, rigid_body(file, convex_hulls(file.to_mesh(), max_hulls) if hulls is None else hulls)
