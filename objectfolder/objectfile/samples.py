"""Object Files that come with the package, built from the starter catalogue."""

from pathlib import Path

from objectfolder.base.errors import ObjectFolderError, quoted

_FOLDER = Path(__file__).with_suffix("")


def available_samples() -> list[str]:
    """Return the names of the samples."""
    return sorted(path.stem for path in _FOLDER.glob("*.safetensors"))


def sample_path(name: str) -> Path:
    """Return the file of a sample.

    Raises ObjectFolderError if there is none of this name.
    """
    if name not in (names := available_samples()):
        raise ObjectFolderError(f"no sample {quoted(name)}: expected one of {', '.join(names)}")
    return _FOLDER / f"{name}.safetensors"


def file_or_sample(given: Path) -> Path:
    """Return a path, or the sample of that name if there is no such file."""
    named = str(given)
    return sample_path(named) if named in available_samples() and not given.is_file() else given
