"""YAML: files whose authors may mean harm are read, and words of strangers are written.

Bombs of aliases, deep nesting and long values are refused.
"""

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from objectfolder.base.errors import ObjectFolderError, shortened
from objectfolder.base.text import visible

MAX_YAML = 2**24  #: size limit of a YAML file, characters, with a copy for each alias
MAX_SCALAR = 2000  #: length limit of a value in it, characters
MAX_NESTING = 50  #: limit of collections in each other


def is_yaml_name(value: object) -> bool:
    """Return whether a value is a name or path that ends like a YAML file's."""
    return isinstance(value, str | Path) and Path(value).suffix in (".yaml", ".yml")


def read_yaml(path: str | Path) -> Any:
    """Read a YAML file as `check_yaml` does; a value of a wrong type or a key twice is an error too."""
    from ruamel.yaml import YAML

    text = check_yaml(path)
    try:
        return YAML(typ="safe").load(text)
    except Exception as error:  # of a value's own type as well
        raise _no_yaml(path, error) from error


def yaml_text(values: Mapping[str, Any], *in_quotes: str) -> str:
    """Return a mapping as YAML; texts of the names ``in_quotes`` are in quotes. See `inline_lists`."""
    from ruamel.yaml import YAML
    from ruamel.yaml.scalarstring import DoubleQuotedScalarString

    written = {
        name: DoubleQuotedScalarString(visible(value)) if name in in_quotes else inline_lists(value)
        for name, value in values.items()
    }
    yaml, stream = YAML(), io.StringIO()
    yaml.width = MAX_YAML  # a line is never broken
    yaml.dump(written, stream)
    return stream.getvalue()


def inline_lists(value: Any) -> Any:
    """Return nested values whose lists take one line in YAML, if they hold no mapping."""
    from ruamel.yaml.comments import CommentedSeq

    if isinstance(value, Mapping):
        return {name: inline_lists(each) for name, each in value.items()}
    if not isinstance(value, list):
        return value
    written = CommentedSeq(map(inline_lists, value))
    if not any(isinstance(each, Mapping) for each in value):
        written.fa.set_flow_style()
    return written


def check_yaml(path: str | Path) -> str:
    """Return the text of a YAML file that is safe to load.

    Loading descends into nested collections, and what is loaded may be written out: a copy for each alias.
    Raises ObjectFolderError if it cannot be read, is not YAML, is nested too deeply, has a very long value,
    refers to itself, or would be too large with a copy for each alias.
    """
    from ruamel.yaml import YAML

    try:
        text = Path(path).read_text(encoding="utf-8")
        problem = _yaml_problem(YAML(typ="safe").parse(text))
    except Exception as error:
        raise _no_yaml(path, error) from error
    if problem:
        raise ObjectFolderError(f"{path} {problem}; shorten it")
    return text


def _yaml_problem(events: Any) -> str:
    """Return what makes YAML unsafe to load, or nothing."""
    from ruamel.yaml.events import AliasEvent, CollectionEndEvent, CollectionStartEvent, ScalarEvent

    sizes: dict[str, int] = {}  # of what an anchor names
    around: list[tuple[str, int]] = []  # anchor of each collection around, and its size so far
    for event in events:
        anchor, size = getattr(event, "anchor", None) or "", 1
        if isinstance(event, CollectionStartEvent):
            around.append((anchor, size))
            if len(around) > MAX_NESTING:
                return f"has collections in each other more than {MAX_NESTING} deep"
            continue
        if isinstance(event, AliasEvent):
            if anchor in (name for name, _ in around):
                return f"has the alias *{shortened(anchor, 60)} in what it stands for"
            size += sizes.get(anchor, 0)
        elif isinstance(event, ScalarEvent):
            size += len(event.value)
            if size > MAX_SCALAR:
                return f"has a value of {size - 1:,} characters, expected at most {MAX_SCALAR:,}"
        elif isinstance(event, CollectionEndEvent):
            anchor, size = around.pop()
        else:
            continue
        if anchor and not isinstance(event, AliasEvent):
            sizes[anchor] = size
        if around:
            around[-1] = (around[-1][0], around[-1][1] + size)
        if size > MAX_YAML:
            return f"has over {MAX_YAML:,} characters with a copy for each alias"
    return ""


def merge_conflict(path: str | Path) -> str:
    """Return what to do about the first conflict of Git in a file; empty if there is none."""
    try:
        lines = Path(path).read_bytes().split(b"\n")
    except OSError:
        return ""
    marked = [number for number, line in enumerate(lines, 1) if line.startswith((b"<<<<<<< ", b">>>>>>> "))]
    if not marked:
        return ""
    remedy = f"keep one side, such as with `git checkout --ours {path}` or `--theirs`, then `git add {path}`"
    return f"{path}, line {marked[0]} has a merge conflict of Git; {remedy}"


def _no_yaml(path: str | Path, error: Exception) -> ObjectFolderError:
    if conflict := merge_conflict(path):
        return ObjectFolderError(conflict)
    mark = getattr(error, "problem_mark", None)
    line = f", line {mark.line + 1}" if mark is not None else ""
    problem = shortened(str(getattr(error, "problem", None) or error), 300)
    return ObjectFolderError(f"{path}{line} is not valid YAML: {problem}; correct it, or restore it from git")
