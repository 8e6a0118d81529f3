"""Files that a mesh names: path safety, existence, image decoding."""

import warnings
from io import BytesIO
from pathlib import Path, PurePosixPath, PureWindowsPath

from PIL import Image

from objectfolder.errors import ObjectFolderError

MAX_IMAGE_SIDE = 16384  #: pixels
Image.MAX_IMAGE_PIXELS = MAX_IMAGE_SIDE**2  # in place of Pillow's own, lower limit


def referenced_path(mesh: Path, name: str) -> PurePosixPath:
    """Return the path of a file that a mesh names, relative to the mesh's folder.

    Raises
    ------
    ObjectFolderError
        If it lies outside that folder.
    """
    path = PurePosixPath(name.replace("\\", "/"))
    if path.is_absolute() or PureWindowsPath(name).drive or ".." in path.parts:
        raise ObjectFolderError(
            f"{mesh} refers to {name}, outside its folder; put that file beside the mesh and edit the "
            f"path in the {'.mtl' if mesh.suffix.lower() == '.obj' else mesh.suffix} file"
        )
    return path


def read_referenced(mesh: Path, name: str) -> bytes:
    """Read a file that a mesh names.

    Raises
    ------
    ObjectFolderError
        If it is missing, or outside the mesh's folder.
    """
    source = mesh.parent / referenced_path(mesh, name)
    if not source.is_file():
        raise ObjectFolderError(f"{mesh} refers to {source}, which does not exist; put it there")
    return source.read_bytes()


def read_image(data: bytes, name: str | Path, mesh: Path) -> Image.Image:
    """Decode an image that a mesh refers to.

    Parameters
    ----------
    data : bytes
        PNG, JPEG or another format that Pillow reads.
    name : str or Path
        Name of the image in error messages.
    mesh : Path
        Mesh that refers to it, for error messages.

    Returns
    -------
    Image
        RGB.

    Raises
    ------
    ObjectFolderError
        If it is damaged or larger than `MAX_IMAGE_SIDE`.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # sides are checked below
            image = Image.open(BytesIO(data))
        if max(image.size) <= MAX_IMAGE_SIDE:
            return image.convert("RGB")
        size = "{} x {}".format(*image.size)
    except Image.DecompressionBombError as error:
        size = str(error)
    except Exception as error:  # Pillow's plugins raise anything on damaged files
        raise ObjectFolderError(
            f"{mesh}: its texture {name} cannot be read as an image ({error}); replace it"
        ) from error
    raise ObjectFolderError(
        f"{mesh}: its texture {name} is too large ({size} pixels); expected at most {MAX_IMAGE_SIDE} on a "
        "side: scale it down"
    )
