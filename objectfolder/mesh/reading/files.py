"""Files that a mesh names: path safety, existence, image decoding."""

import unicodedata
from io import BytesIO
from os.path import normpath
from pathlib import Path, PurePosixPath, PureWindowsPath

from PIL import Image

from objectfolder.base.errors import ObjectFolderError, shortened
from objectfolder.base.pictures import decoded

HERE = PurePosixPath()
#: Folders that collections keep textures in, from that of the mesh; the last three are neighbours of it.
TEXTURE_FOLDERS = (
    HERE,
    *map(PurePosixPath, ("textures", "images", "materials/textures")),
    *map(PurePosixPath, ("../textures", "../images", "../materials/textures")),
)
MAX_NAME = 255  #: bytes of a file's or folder's name, as file systems have it
MAX_PATH = 1024  #: bytes of a path inside the mesh's folder


def referenced_path(mesh: Path, name: str, beside: PurePosixPath = HERE, said_in: str = "") -> PurePosixPath:
    """Return the path of a file that a mesh names, relative to the mesh's folder.

    The name is relative to the folder ``beside``, itself relative to the mesh's. Errors tell to edit the
    file of suffix ``said_in``, by default the mesh. Raises `ObjectFolderError` if the path lies outside
    that folder, or is too long for a file system.
    """
    written = PurePosixPath(name.replace("\\", "/"))
    path = PurePosixPath(normpath(beside / written)) if beside.parts else written
    where = f"the path in the {said_in or mesh.suffix} file"
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


def find_referenced(
    mesh: Path, name: str, beside: PurePosixPath = HERE, said_in: str = "", any_case: bool = False
) -> PurePosixPath:
    """Return the path of a file that a mesh names, relative to the mesh's folder.

    If the file is not where the mesh says, it is looked up by its last name in `TEXTURE_FOLDERS`. The
    composed and decomposed forms of Unicode are the same name, and with ``any_case`` upper and lower case,
    if no name is as it is written. Other arguments and errors are those of
    `referenced_path`, whose path it returns if there is no such file.
    """
    last = PurePosixPath(PurePosixPath(name.replace("\\", "/")).name)
    try:
        written, error = referenced_path(mesh, name, beside, said_in), None
        places = [written]
    except ObjectFolderError as refusal:
        error, places = refusal, []
    if last.name and _size(last.name) <= MAX_NAME:
        places += [folder / last for folder in TEXTURE_FOLDERS]
    for place in places:
        if found := _on_disk(mesh.parent, place, any_case):
            return found
    if error is not None:
        raise error
    return written


def _on_disk(folder: Path, path: PurePosixPath, any_case: bool) -> PurePosixPath | None:
    """Return the path of an existing file with the names that it has there, or None."""
    if (folder / path).is_file():
        return path
    if str(path).isascii() and not any_case:
        return None
    found = HERE
    for part in path.parts:
        here, name = folder / found, _fold(part, any_case)
        names = sorted(other.name for other in here.iterdir()) if here.is_dir() else []
        same = [other for other in names if _fold(other, any_case) == name]
        found /= part if part in (*names, "..") or not same else same[0]
    return found if (folder / found).is_file() else None


def _fold(name: str, any_case: bool) -> str:
    """Return what forms of a name have in common: of Unicode, and of case."""
    name = unicodedata.normalize("NFC", name)
    return name.casefold() if any_case else name


def _size(name: str) -> int:
    return len(name.encode(errors="replace"))


def read_referenced(mesh: Path, name: str | PurePosixPath, remedy: str = "put it there") -> bytes:
    """Read a file that a mesh names, by its name or its path from `find_referenced`.

    Raises `ObjectFolderError` if it is missing, outside the mesh's folder, or cannot be read.
    """
    source = mesh.parent / (find_referenced(mesh, name) if isinstance(name, str) else name)
    try:
        if source.is_file():
            return source.read_bytes()
    except OSError as error:
        raise ObjectFolderError(
            f"{mesh} refers to {source}, which cannot be read: {error.strerror}"
        ) from error
    hint = _other_case(source)
    raise ObjectFolderError(f"{mesh} refers to {source}, which does not exist{hint}; {remedy}")


def _other_case(path: Path) -> str:
    """Name a file whose name differs from a missing one's in case only, for its error message."""
    beside = sorted(path.parent.iterdir()) if path.parent.is_dir() else []
    name = path.name.casefold()
    alike = [other.name for other in beside if other.name.casefold() == name and other.is_file()]
    return f" ({alike[0]} does: upper and lower case differ)" if alike else ""


def read_image(data: bytes, name: str | Path, mesh: Path, mode: str = "RGB") -> Image.Image:
    """Decode an image that a mesh refers to, with pixels of Pillow's ``mode``; ``name`` is for messages.

    Raises `ObjectFolderError` if `objectfolder.base.pictures.decoded` does not take it.
    """
    return decoded(BytesIO(data), f"{mesh}: its texture {shortened(name)}", mode)
