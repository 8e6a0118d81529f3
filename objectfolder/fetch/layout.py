"""Find the mesh among the files of a source, and copy it with its materials and textures."""

import shutil
from pathlib import Path

from objectfolder.errors import ObjectFolderError
from objectfolder.fetch.catalogue import MeshSource
from objectfolder.mesh.reading.load import FORMATS
from objectfolder.workspace.objects import references


def find_mesh(tree: Path, source: MeshSource) -> Path:
    """Return the mesh at the source's path, otherwise with the source's file name, otherwise the only mesh.

    Raises
    ------
    ObjectFolderError
        If there is none, or more than one.
    """
    files = [path for path in _files(tree) if path.suffix.lower() in FORMATS]
    found = (
        [path for path in files if path.relative_to(tree).match(source.mesh)]
        or [path for path in files if path.match(Path(source.mesh).name)]
        or files
    )
    if len(found) == 1:
        return found[0]
    shown = ", ".join(str(path.relative_to(tree)) for path in (found or _files(tree))[:8]) or "nothing"
    expected = f"one mesh ({source.mesh}, or the only {', '.join(FORMATS)})"
    raise ObjectFolderError(
        f"it has {'several meshes' if found else 'no mesh'}: {shown}; expected {expected}"
    )


def collect(mesh: Path, tree: Path, into: Path) -> tuple[Path, dict[str, Path]]:
    """Copy a mesh and the files that it refers to into one folder.

    A file that is not at its path is looked up by name in the whole tree: Google Scanned Objects keep the
    texture in another folder than the material. Missing files are reported later, by ``add_mesh``.

    Parameters
    ----------
    mesh : Path
    tree : Path
        Folder with the files of the source.
    into : Path
        New directory.

    Returns
    -------
    mesh : Path
        The copy.
    files : dict of str to Path
        All copies, by their path relative to ``into``.

    Raises
    ------
    ObjectFolderError
        If the mesh cannot be read, or refers to a file outside its folder.
    """
    into.mkdir()
    copy = into / mesh.name
    shutil.copyfile(mesh, copy)
    copied = {mesh.name: copy}
    try:
        # Lazy: an OBJ's textures are read from the copy of the material file, which comes first.
        for name in references(copy):
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
    return sorted(
        path
        for path in tree.rglob("*")
        if path.is_file()
        and not any(part.startswith((".", "__MACOSX")) for part in path.relative_to(tree).parts)
    )
