"""Find the meshes in a folder that may become objects."""

import re
import unicodedata
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from objectfolder.base.errors import ObjectFolderError
from objectfolder.mesh.reading.load import FORMATS
from objectfolder.workspace.examine import Candidate
from objectfolder.workspace.materials_list import read_materials, read_objects
from objectfolder.workspace.params import KEY, MAX_KEY

#: Other formats of shapes, whose files are not read.
UNREAD = (
    ".3ds",
    ".3mf",
    ".blend",
    ".dae",
    ".fbx",
    ".igs",
    ".iges",
    ".step",
    ".stp",
    ".usd",
    ".usda",
    ".usdc",
    ".usdz",
)
SCANS = {
    "google_16k",
    "google_64k",
    "google_512k",
    "poisson",
    "tsdf",
}  #: folders of meshes of one object, of YCB
INNER = {
    "mesh",
    "meshes",
    "model",
    "models",
    "visual",
    *SCANS,
}  #: folders inside an object's, which name none


def slug(name: str, numbered: bool = False) -> str:
    """Make an object key from a file or folder name: ``025_Mug (blue)`` gives ``mug_blue``.

    Numbers at either end go, unless there is nothing else, or the key is to be numbered: ``obj_000001`` and
    ``025_mug`` give ``obj_000001`` and ``mug_025`` then.
    """
    ascii_name = unicodedata.normalize("NFKD", name).encode("ascii", "ignore").decode().lower()
    words = re.sub(r"[^a-z0-9]+", "_", ascii_name).strip("_")
    key = words.strip("_0123456789")
    if not key:
        return f"object_{words}" if words else "object"
    if not numbered:
        return key
    start = words.index(key)
    return "_".join(part for part in (key + words[start + len(key) :], words[:start].strip("_")) if part)


def discover(folder: Path, material: str | None = None) -> list[Candidate]:
    """Find the objects in a folder: each mesh file directly in it, and each subfolder that holds one.

    Keys are made from file or subfolder names, which keep their numbers where others have the same words.
    Folders such as ``meshes`` or ``google_16k`` belong to the object of the folder above.
    ``materials.csv`` or ``materials.yaml`` in the folder (`objectfolder.workspace.materials_list`) assigns
    materials and more by file, subfolder or key; ``material`` is that of the others. Returns
    candidates by name; those with a duplicate key have a refusal. Raises ObjectFolderError if there is no
    mesh, or the list of materials is invalid or names an unknown object.
    """
    listed = read_materials(folder)
    found = [(path.stem, [path]) for path in _meshes(folder)]
    for child in sorted(path for path in folder.iterdir() if path.is_dir() and path.name[0] != "."):
        inside = _meshes(child) or sorted(p for p in child.rglob("*") if _is_mesh(p))
        numbered = len(inside) > 1 and len({path.parent for path in inside}) == 1
        numbered &= len({slug(path.stem) for path in inside}) == 1 < len({path.stem for path in inside})
        if child.name.lower() in INNER and numbered:  # instances in the folder of a collection
            found += [(path.stem, [path]) for path in inside]
        elif inside:
            found.append((child.name, inside))
    if not found:
        raise ObjectFolderError(
            f"{folder} and its subfolders hold no mesh ({', '.join(FORMATS)}); put each object's mesh there, "
            "or in a subfolder of its own"
        )
    home = folder.resolve()
    inner = all(name.lower() in INNER and inside[0].parent != folder for name, inside in found)
    if inner or home.name.lower() in SCANS or (len(found) == 1 and found[0][1][0].parent == folder):
        name = home.parent.name if home.name.lower() in INNER else home.name
        found = [(name, [mesh for _, inside in found for mesh in inside])]
    words = Counter(slug(name) for name, _ in found)
    keys = [slug(name, numbered=words[slug(name)] > 1) for name, _ in found]
    sharing: dict[str, list[str]] = {}  # names of files and subfolders that give a key
    for key, (name, inside) in zip(keys, found, strict=True):
        own_file = inside[0].parent == folder
        sharing.setdefault(key, []).append(inside[0].name if own_file else f"{name}/")
    candidates, named = [], set()
    for key, (name, inside) in zip(keys, found, strict=True):
        mesh = inside[0]
        own_names = (mesh.stem, home.name) if mesh.parent == folder else ()
        names = [unicodedata.normalize("NFC", one) for one in (name, mesh.name, key, *own_names)]
        named |= {*names}
        refusal = None
        if len(sharing[key]) > 1:
            each = "both" if len(sharing[key]) == 2 else "all"
            refusal = (
                f"{_listed(sharing[key])} in {folder} would {each} be named {key!r}; rename all but one, or "
                "add one by its path"
            )
        given = {"material": material} | next((listed[n] for n in names if n in listed), {})
        candidates.append(Candidate(key, mesh, refusal=refusal, others=tuple(inside[1:]), **given))
    unknown = sorted(set(listed) - named)
    if unknown:
        raise ObjectFolderError(
            f"the list of materials in {folder} names {', '.join(unknown[:5])}, which it does not contain"
        )
    return candidates


def discover_listed(table: Path, material: str | None = None) -> list[Candidate]:
    """Find the objects of a table (`objectfolder.workspace.materials_list.read_objects`) beside it.

    A row's mesh is the file of its column ``mesh``, or else the file or the folder that it names. Keys are
    the names, where they are valid. Returns candidates in the order of the table; those without a mesh, or
    with a duplicate key, have a refusal. Raises ObjectFolderError if the table cannot be read.
    """
    candidates: list[Candidate] = []
    folder, taken = table.parent, dict[str, str]()
    for name, fields in read_objects(table).items():
        key = name if KEY.fullmatch(name) and len(name) <= MAX_KEY else slug(name, numbered=True)
        place = folder / fields.pop("mesh", name)
        if place.is_dir():
            inside = _meshes(place) or sorted(path for path in place.rglob("*") if _is_mesh(path))
        else:
            inside = [
                path for path in (place, *(folder / f"{name}{end}" for end in FORMATS)) if _is_mesh(path)
            ]
        refusal = None
        if not inside:
            refusal = (
                f"{place} is no mesh ({', '.join(FORMATS)}), nor a folder with one; give its path in a "
                f"column `mesh` of {table.name}"
            )
        elif key in taken:
            refusal = f"{name!r} and {taken[key]!r} in {table} would both be named {key!r}; rename one"
        taken.setdefault(key, name)
        given = {"material": material} | fields
        mesh, others = (inside or [place])[0], tuple(inside[1:])
        candidates.append(Candidate(key, mesh, refusal=refusal, others=others, **given))
    return candidates


def passed_over(folder: Path) -> list[Path]:
    """Return the files of a folder that hold a shape, it seems, but are not read: for none of its objects.

    They are of another format, or links to nothing. Files beside a mesh of their name, or in a subfolder with
    a mesh, are taken for copies.
    """
    known = {path.stem for path in _meshes(folder)}
    found = [path for path in folder.iterdir() if path.stem not in known]
    for child in folder.iterdir():
        if child.is_dir() and child.name[0] != "." and not any(_is_mesh(p) for p in child.rglob("*")):
            found += child.rglob("*")
    shapes = [path for path in found if path.suffix.lower() in (*UNREAD, *FORMATS) and path.name[0] != "."]
    return sorted(path for path in shapes if not _is_mesh(path) and not path.is_dir())


def _listed(names: Sequence[str], most: int = 4) -> str:
    """Join names with commas and "and"; of many, the first."""
    shown = list(names) if len(names) <= most else [*names[: most - 1], f"{len(names) - most + 1} more"]
    return f"{', '.join(shown[:-1])} and {shown[-1]}"


def _is_mesh(path: Path) -> bool:
    return path.suffix.lower() in FORMATS and path.name[0] != "." and path.is_file()


def _meshes(folder: Path) -> list[Path]:
    return sorted(path for path in folder.iterdir() if _is_mesh(path))
