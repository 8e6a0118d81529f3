"""What the readers of mesh files give: pieces of a mesh, each with one material."""

import warnings
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path, PurePosixPath, PureWindowsPath

import numpy as np
from PIL import Image

from objectfolder.errors import ObjectFolderError

MAX_IMAGE_SIDE = 16384  #: pixels
Image.MAX_IMAGE_PIXELS = MAX_IMAGE_SIDE**2  # of the limit per side, not of Pillow's own


@dataclass(frozen=True, eq=False)
class Material:
    """Base colour, roughness and metallic of one material."""

    image: Image.Image | None = None  #: sRGB base colour, RGB
    color: np.ndarray | None = None  #: (3,) linear base colour, multiplies `image`; None: not said
    roughness: float | None = None
    metallic: float | None = None
    wrap: tuple[str, str] = ("repeat", "repeat")  #: beyond [0, 1] in u and v: repeat, clamp or mirror


@dataclass(frozen=True)
class Part:
    """Triangles of one material."""

    vertices: np.ndarray  #: (V, 3) float64
    faces: np.ndarray  #: (F, 3) int64, counter-clockwise seen from outside
    material: Material
    uv: np.ndarray | None = None  #: (V, 2) float64, origin at the lower left of the image
    colors: np.ndarray | None = None  #: (V, 3) linear colours in [0, 1] that multiply the material's
    normals: np.ndarray | None = None  #: (V, 3) of the file, of any length; None where it has none

    @property
    def used(self) -> np.ndarray:
        """(V,) bool, whether faces use each vertex."""
        used = np.zeros(len(self.vertices), bool)
        used[self.faces] = True
        return used


@dataclass(frozen=True)
class Parts:
    """A mesh file's content."""

    parts: list[Part]
    notes: list[str] = field(default_factory=list)  #: what of its appearance was left out, for people


def inside(mesh: Path, name: str) -> PurePosixPath:
    """Return the path, relative to a mesh's folder, that the mesh names.

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
    source = mesh.parent / inside(mesh, name)
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
        The image, for messages.
    mesh : Path
        The mesh that refers to it, for messages.

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
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # the sides are checked here
            image = Image.open(BytesIO(data))
        if max(image.size) <= MAX_IMAGE_SIDE:
            return image.convert("RGB")
        size = "{} x {}".format(*image.size)
    except Image.DecompressionBombError as error:
        size = str(error)
    except Exception as error:  # Pillow's plugins raise whatever they like on damaged files
        raise ObjectFolderError(
            f"{mesh}: its texture {name} cannot be read as an image ({error}); replace it"
        ) from error
    raise ObjectFolderError(
        f"{mesh}: its texture {name} is too large ({size} pixels); expected at most {MAX_IMAGE_SIDE} on a "
        "side: scale it down"
    )
