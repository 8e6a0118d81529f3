"""The package whose code a workspace runs: its own copy in a clone, else the installed version.

A workspace made by ``objectfolder init`` holds no package. Its file `RECORD` names the digests of the version
that it was made for, so that a build with any other version is refused instead of mixing the two.
"""

from pathlib import Path

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.io import file_digest

PACKAGE = "objectfolder"
#: In a workspace: digests of the installed package, and of the files that ``objectfolder init`` wrote.
RECORD = "objectfolder.sha256"
INSTALLED = Path(__file__).resolve().parents[2]  #: directory that contains the package that runs now
#: Folder of a workspace with sensor profiles of its own, beside those of the package.
SENSORS = "sensors"
PROFILES = f"{PACKAGE}/touch/profiles"
#: The pipeline of a clone's top level, as a wheel holds it.
PIPELINE = f"{PACKAGE}/workspace/pipeline"
#: Files of the top level that a workspace starts from.
PIPELINE_FILES = (
    ".dvcignore",
    "catalogs/*.yaml",
    "dvc.yaml",
    "materials/README.md",
    "params/*.yaml",
    "stages/*.py",
)


def located(name: str, root: str | Path = ".") -> Path:
    """Return the path of a file of the package or the workspace.

    ``name`` is relative to the workspace ``root``, or to the directory that contains the package. A workspace
    without the package may hold sensor profiles in `SENSORS`; they come before the package's.
    """
    root = Path(root)
    if name.partition("/")[0] != PACKAGE or not runs_installed(root):
        return root / name
    own = root / SENSORS / name.removeprefix(f"{PROFILES}/")
    return own if name.startswith(f"{PROFILES}/") and own.is_file() else INSTALLED / name


def sensor_file(name: str, root: str | Path = ".") -> Path:
    """Return the profile of a sensor, of the workspace or of the package."""
    return located(f"{PROFILES}/{name}.yaml", root)


def runs_installed(root: str | Path = ".") -> bool:
    """Return whether a workspace has no package of its own, as a clone has."""
    return not Path(root, PACKAGE, "__init__.py").is_file()


def is_recorded(root: str | Path = ".") -> bool:
    """Return whether a workspace runs the installed package, and records its version."""
    return runs_installed(root) and Path(root, RECORD).is_file()


def pipeline_folder() -> Path:
    """Return the folder of the files that a workspace starts from.

    Raises ObjectFolderError if the installed package lacks them.
    """
    packaged = INSTALLED / PIPELINE
    home = packaged if packaged.is_dir() else INSTALLED  # in a clone: the repository itself
    if not (home / "dvc.yaml").is_file():
        raise ObjectFolderError(
            f"the objectfolder in {INSTALLED} lacks the pipeline ({packaged}); install it again from a wheel "
            "or a clone"
        )
    return home


def pipeline_files() -> dict[str, Path]:
    """Map the files that a workspace starts from to where this version keeps them, sorted by name."""
    home = pipeline_folder()
    found = {path.relative_to(home).as_posix(): path for name in PIPELINE_FILES for path in home.glob(name)}
    return dict(sorted(found.items()))


def package_digests() -> dict[str, str]:
    """Return the SHA-256 of every file of the package that runs now, by name, sorted."""
    home = INSTALLED / PACKAGE
    files = {path.relative_to(INSTALLED).as_posix(): path for path in home.rglob("*") if path.is_file()}
    files = {name: path for name, path in files.items() if "__pycache__" not in path.parts}
    files |= {f"{PIPELINE}/{name}": path for name, path in pipeline_files().items()}
    return {name: file_digest(files[name]) for name in sorted(files)}


def read_record(root: str | Path = ".") -> dict[str, str]:
    """Return the digests in a workspace's record by name."""
    lines = Path(root, RECORD).read_text().splitlines()
    return {name: digest for digest, _, name in (line.partition("  ") for line in lines)}


def changed_files(root: str | Path = ".") -> list[str]:
    """List the files of the package that differ from a workspace's record, or are in one of them only."""
    recorded = {n: digest for n, digest in read_record(root).items() if n.startswith(f"{PACKAGE}/")}
    found = package_digests()
    return sorted(n for n in recorded.keys() | found.keys() if recorded.get(n) != found.get(n))


def check_installed(root: str | Path = ".") -> None:
    """Check that the installed package is the one that a workspace records, if it records one.

    Raises ObjectFolderError if it is another version, or was edited.
    """
    if is_recorded(root) and (changed := changed_files(root)):
        differing = "1 file differs" if len(changed) == 1 else f"{len(changed)} files differ"
        raise ObjectFolderError(
            f"this workspace was made with another version of objectfolder than {INSTALLED}: "
            f"{differing} ({', '.join(changed[:3])}{', ...' * (len(changed) > 3)}); run "
            "`objectfolder upgrade`, or install the version that requirements.txt names"
        )
