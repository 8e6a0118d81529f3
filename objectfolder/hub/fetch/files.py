"""Find an object's archive or folder in a directory, and the mesh in it; copy it with its textures."""

import difflib
import shutil
from pathlib import Path, PurePosixPath
from urllib.parse import unquote

from objectfolder.base.errors import ObjectFolderError
from objectfolder.hub.fetch.archive import SUFFIXES
from objectfolder.hub.fetch.catalogue import Catalogue, MeshSource, comparable_name
from objectfolder.mesh.reading.load import FORMATS
from objectfolder.workspace.objects import references


def check_directory(directory: Path) -> None:
    """Raise ObjectFolderError unless ``--from`` names a directory."""
    if not directory.is_dir():
        expected = "expected one with archives or folders"
        raise ObjectFolderError(f"--from {directory} is not a directory; {expected}")


def find_local(directory: Path, catalogue: Catalogue, key: str) -> Path:
    """Find the archive or folder of an object in a directory.

    Case and punctuation are ignored. Accepted names: its published name, its id at the source, either of
    these after the source's name, and the name of the source's archive; otherwise, the object's key, names
    that start with the id, as ``025_mug_google_64k.tgz``, names that have one word before it, as
    ``ph_barrel_01``, or the directory itself. Raises ObjectFolderError if nothing matches, or more than one;
    the message lists candidates.
    """
    check_directory(directory)
    entry = catalogue.objects[key]
    ids = {comparable_name(entry.name), comparable_name(entry.source_model)}
    archive = unquote(catalogue.archive_name(key))
    published = ids | {comparable_name(f"{entry.source}_{name}") for name in ids} | {_form(archive)}
    exact = published | {comparable_name(key)}
    candidates = sorted(
        path
        for path in directory.iterdir()
        if not path.name.startswith(".") and (path.is_dir() or path.name.lower().endswith(SUFFIXES))
    )
    endings = tuple(name.replace("_", "") for name in ids)
    found = (
        [path for path in candidates if _form(path.name) in published]
        or [path for path in candidates if _form(path.name) in exact]
        or [path for path in candidates if any(_form(path.name).startswith(f"{name}_") for name in ids)]
        or [path for path in candidates if _form(path.name).partition("_")[2].replace("_", "") in endings]
        or [path for path in [directory.resolve()] if _form(path.name) in exact]
    )
    if len(found) > 1:
        names, many = ", ".join(path.name for path in found), f"{len(found)} candidates"
        raise ObjectFolderError(f"{directory} has {many} for {key} ({entry.name}): {names}; keep only one")
    if not found:
        forms = {_form(path.name): path.name for path in candidates}
        near = [forms[form] for name in exact for form in difflib.get_close_matches(name, forms, 2)]
        shown = list(dict.fromkeys(near)) or [path.name for path in candidates]
        raise ObjectFolderError(
            f"{directory} has no archive or folder of {key}; expected a name such as {entry.name}, "
            f"{archive} or {key}; {'similar' if near else 'found'}: {', '.join(shown[:8]) or 'nothing'}"
        )
    return found[0]


def _form(name: str) -> str:
    suffix = next((suffix for suffix in SUFFIXES if name.lower().endswith(suffix)), "")
    return comparable_name(name[: len(name) - len(suffix)])


def find_mesh(tree: Path, source: MeshSource) -> Path:
    """Return the mesh at the source's path, or of its name, or the only one; ObjectFolderError otherwise."""
    files = [path for path in _files(tree) if path.suffix.lower() in FORMATS]
    found = (
        [path for path in files if path.relative_to(tree).match(source.mesh)]
        or [path for path in files if path.match(Path(source.mesh).name)]
        or files
    )
    if len(found) == 1:
        return found[0]
    shown = ", ".join(str(path.relative_to(tree)) for path in (found or _files(tree))[:8]) or "nothing"
    found_what = "several meshes" if found else "no mesh"
    expected = f"one mesh ({source.mesh}, or the only {', '.join(FORMATS)})"
    raise ObjectFolderError(f"it has {found_what}: {shown}; expected {expected}")


def collect(mesh: Path, tree: Path, into: Path) -> tuple[Path, dict[str, Path]]:
    """Copy a mesh and the files that it refers to into one folder.

    A file that is not at its path is looked up by name in the whole tree: Google Scanned Objects keep the
    texture in another folder than the material. Missing files are reported later, by ``add_mesh``. Returns
    the copy of the mesh, and all copies by their path relative to ``into``, a new folder. Raises
    ObjectFolderError if the mesh cannot be read, or refers to a file outside its folder.
    """
    into.mkdir()
    copy = into / mesh.name
    shutil.copyfile(mesh, copy)
    copied = {mesh.name: copy}
    try:
        # Lazy: an OBJ's textures are read from the copy of the material file, which comes first.
        for name in references(copy):
            if ".." in name.parts:  # beside this copy, by chance
                name = PurePosixPath(name.name)
            beside = mesh.parent / name
            elsewhere = [path for path in _files(tree) if path.name == name.name]
            found = [beside] if beside.is_file() else elsewhere
            if len(found) == 1 and str(name) not in copied:
                target = into / name
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(found[0], target)
                copied[str(name)] = target
    except ObjectFolderError:
        raise
    except (ValueError, TypeError, AttributeError) as error:  # not the JSON of a glTF
        raise ObjectFolderError(f"{mesh.name} cannot be read as a mesh: {error}") from error
    return copy, copied


def _files(tree: Path) -> list[Path]:
    """List files, without the hidden ones that macOS adds to archives."""
    files = (path for path in tree.rglob("*") if path.is_file())
    hidden = (".", "__MACOSX")
    return sorted(f for f in files if not any(p.startswith(hidden) for p in f.relative_to(tree).parts))
