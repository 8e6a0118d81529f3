"""What users name Object Files by."""

from pathlib import Path

from objectfolder.base.errors import ObjectFolderError, shortened
from objectfolder.objectfile.samples import available_samples, sample_path
from objectfolder.workspace.layout import Benchmarks, Build

#: What a name may be, for help and errors; a name that is several is the first of them.
FORMS = (
    "file, release or folder of builds, key of a built object of this workspace, or sample "
    f"({', '.join(available_samples())})"
)


def find_object_files(given: Path) -> list[Path]:
    """Return the Object Files that a user names.

    The first of `FORMS` that the name is; those of a folder are in it or below.

    Raises ObjectFolderError if it is none of them, or a file of a release is not what its index says.
    """
    if _exists(given) and not given.is_dir():
        return [given]
    if given.is_dir() and (found := _inside(given)):
        return found
    name, built = str(given), Build(given.name).object_file
    if name.isidentifier() and built.is_file():
        return [built]
    if name in available_samples():
        return [sample_path(name)]
    if given.is_dir():
        raise ObjectFolderError(
            f"no Object Files in {given}: no {built.name} in it or below, and it is not a release; run "
            "`objectfolder build`, or name others"
        )
    hint = "; `objectfolder build` builds objects" if name.isidentifier() else ""
    raise ObjectFolderError(f"{shortened(given, 300)} does not exist; expected a {FORMS}{hint}")


def own_keys(given: Path) -> list[str]:
    """Return the keys of objects of this workspace that a user names: a key, or what was built.

    A key is not looked up. Raises ObjectFolderError if an Object File is not one of this workspace.
    """
    if not (_exists(given) and (not given.is_dir() or _inside(given))):
        return [str(given)]
    keys = []
    for path in find_object_files(given):
        keys.append(path.absolute().parent.name)
        if path.absolute().parent.resolve() != Build(keys[-1]).dir.resolve():
            raise ObjectFolderError(
                f"{path} was not built in this workspace; expected a key of params.yaml, or "
                f"{Build('KEY').object_file}"
            )
    return keys


def _inside(folder: Path) -> list[Path]:
    from objectfolder.objectfile.dataset import INDEX, Dataset

    if (folder / INDEX).is_file():
        dataset = Dataset(folder)
        for _ in dataset:  # which compares each file with the index
            pass
        return [dataset.path(key) for key in dataset.keys]
    copies = Benchmarks().observations("any").parent.name  # where benchmarks put Object Files, too
    found = folder.rglob(Build("any").object_file.name)
    return sorted(path for path in found if path.absolute().parent.parent.name != copies)


def _exists(path: Path) -> bool:
    try:
        return path.exists()
    except OSError as error:  # a name that is too long, a folder without permission
        raise ObjectFolderError(f"{shortened(path, 300)} cannot be read: {error.strerror}") from error
