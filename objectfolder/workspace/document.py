"""``params.yaml`` as a document whose comments and order survive an edit."""

from collections.abc import Iterator
from contextlib import contextmanager
from io import StringIO
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

from objectfolder.base.io import write_text
from objectfolder.base.locks import exclusive
from objectfolder.base.yamlfile import check_yaml
from objectfolder.workspace.params import read


def editable(path: Path) -> tuple[Any, dict[str, Any]]:
    """Read ``params.yaml`` twice: as a document that keeps comments and order, and as plain values."""
    values = read(path)
    document = YAML().load(check_yaml(path))
    for group in ("objects", "procedural"):
        if not values[group]:
            document[group].fa.set_block_style()  # else all that is added would be on one line
    return document, values


@contextmanager
def edited(path: Path, dry_run: bool = False) -> Iterator[tuple[Any, dict[str, Any]]]:
    """Yield ``params.yaml`` to edit, and its values; then write it. Other processes that edit it wait.

    A dry run writes nothing.
    """
    with exclusive(path.parent):
        document, values = editable(path)
        yield document, values
        if not dry_run:
            write_params(path, document)


def write_params(path: Path, document: Any) -> None:
    """Write an edited document back."""
    yaml = YAML()
    yaml.width = 4096  # an entry stays on its line
    stream = StringIO()
    yaml.dump(document, stream)
    write_text(path, stream.getvalue())
