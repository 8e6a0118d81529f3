"""SHA-256 of the sources of fetched objects, recorded at first use to detect changes."""

from collections.abc import Mapping
from io import StringIO
from pathlib import Path

from ruamel.yaml import YAML

from objectfolder.errors import ObjectFolderError
from objectfolder.io import write_text
from objectfolder.yamlfile import read_yaml

PATH = Path("data/checksums.yaml")
HEADER = (
    "# SHA-256 of the files that `objectfolder fetch` has used, recorded at first use. Commit this file.\n"
)


def read_checksums(path: Path) -> dict[str, dict[str, str]]:
    """Read recorded checksums by object and file name; empty if the file does not exist.

    Raises
    ------
    ObjectFolderError
        If it is damaged.
    """
    if not path.exists():
        return {}
    values = read_yaml(path)
    values = {} if values is None else values
    if not isinstance(values, dict) or not all(isinstance(files, dict) for files in values.values()):
        raise ObjectFolderError(f"{path} does not map objects to files and checksums; restore it from git")
    return values


def check_unchanged(recorded: Mapping[str, str], digests: Mapping[str, str], key: str, path: Path) -> None:
    """Compare checksums with the recorded ones; new files are accepted.

    Raises
    ------
    ObjectFolderError
        If a file has changed.
    """
    for name, digest in digests.items():
        if recorded.get(name, digest) != digest:
            raise ObjectFolderError(
                f"{name} of {key} has changed since it was first used: expected SHA-256 {recorded[name]} "
                f"({path}), got {digest}; to accept the new file, give --accept-changed"
            )


def record_checksums(path: Path, key: str, digests: Mapping[str, str]) -> None:
    """Record the checksums of an object, replacing those of files with the same names."""
    values = read_checksums(path)
    values[key] = {**values.get(key, {}), **digests}
    yaml = YAML(typ="safe")
    yaml.default_flow_style = False
    yaml.width = 4096
    stream = StringIO()
    yaml.dump({name: dict(sorted(values[name].items())) for name in sorted(values)}, stream)
    write_text(path, HEADER + stream.getvalue())
