"""``params.yaml`` as a document whose comments and order survive an edit."""

from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

from objectfolder.io import atomic
from objectfolder.workspace.params import read
from objectfolder.yamlfile import checked_yaml


def editable(path: Path) -> tuple[Any, dict[str, Any]]:
    """Read ``params.yaml`` twice: as a document that keeps comments and order, and as plain values."""
    values = read(path)
    document = YAML().load(checked_yaml(path))
    for group in ("objects", "procedural"):
        if not values[group]:
            document[group].fa.set_block_style()  # else all that is added would be on one line
    return document, values


def write_params(path: Path, document: Any) -> None:
    """Write an edited document back."""
    yaml = YAML()
    yaml.width = 4096  # an entry stays on its line
    with atomic(path) as temporary, temporary.open("w") as stream:
        yaml.dump(document, stream)
