"""Files that a mesh names: path safety, existence, image decoding."""

from io import BytesIO
from pathlib import Path, PurePosixPath, PureWindowsPath

from PIL import Image

from objectfolder.errors import ObjectFolderError, shortened
from objectfolder.pictures import decoded

MAX_NAME = 255  #: bytes of a file's or folder's name, as file systems have it
MAX_PATH = 1024  #: bytes of a path inside the mesh's folder


def referenced_path(mesh: Path, name: str) -> PurePosixPath:
    """Return the path of a file that a mesh names, relative to the mesh's folder.

    Raises
    ------
    ObjectFolderError
        If it lies outside that folder, or is too long for a file system.
    """
    path = PurePosixPath(name.replace("\\", "/"))
    where = f"the path in the {'.mtl' if mesh.suffix.lower() == '.obj' else mesh.suffix} file"
    if path.is_absolute() or PureWindowsPath(name).drive or ".." in path.parts:
        raise ObjectFolderError(
            f"{mesh} refers to {shortened(name)}, outside its folder; put that file beside the mesh and edit "
            + where
        )
    if _size(str(path)) > MAX_PATH or any(_size(part) > MAX_NAME for part in path.parts):
        raise ObjectFolderError(
            f"{mesh} refers to {shortened(name)}, whose name of {len(name)} characters is too long; shorten "
            f"the file's name and {where}"
        )
    return path


def _size(name: str) -> int:
    return len(name.encode(errors="replace"))


def read_referenced(mesh: Path, name: str) -> bytes:
    """Read a file that a mesh names.

    Raises
    ------
    ObjectFolderError
        If it is missing, outside the mesh's folder, or cannot be read.
    """
    source = mesh.parent / referenced_path(mesh, name)
    try:
        if source.is_file():
            return source.read_bytes()
    except OSError as error:
        raise ObjectFolderError(
            f"{mesh} refers to {source}, which cannot be read: {error.strerror}"
        ) from error
    raise ObjectFolderError(f"{mesh} refers to {source}, which does not exist; put it there")


def read_image(data: bytes, name: str | Path, mesh: Path, mode: str = "RGB") -> Image.Image:
    """Decode an image that a mesh refers to.

    Parameters
    ----------
    data : bytes
    name : str or Path
        Name of the image in error messages.
    mesh : Path
        Mesh that refers to it, for error messages.
    mode : str
        Pillow's name of the result's pixels.

    Raises
    ------
    ObjectFolderError
        If `objectfolder.pictures.decoded` does not take it.
    """
    return decoded(BytesIO(data), f"{mesh}: its texture {shortened(name)}", mode)
