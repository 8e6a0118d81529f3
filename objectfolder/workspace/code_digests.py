"""Find the project files that a stage runs, from its source, and digest them."""

import ast
from functools import cache
from pathlib import Path

from objectfolder.io import file_digest

PACKAGES = ("objectfolder", "stages")  #: packages of the project


def imported_files(script: str | Path, root: str | Path = ".") -> list[str]:
    """List the project files that a script imports, directly or indirectly.

    Parameters
    ----------
    script : Path
        The script, relative to ``root``.
    root : Path
        Directory that contains `PACKAGES`.

    Returns
    -------
    list of str
        Sorted, relative to ``root``, with the script itself; empty files (``__init__.py``) are left out.
    """
    root = Path(root)
    todo, found = [root / script], set()
    while todo:
        path = todo.pop()
        name = path.relative_to(root).as_posix()
        if name in found:
            continue
        found.add(name)
        for module in _imports(path.read_text()):
            todo += [file for file in _files(module, root) if file.stat().st_size > 0]
    return sorted(found)


def digests(script: str | Path, root: str | Path = ".") -> str:
    """Return the SHA-256 of every file that a script runs, one per line, in the format of ``sha256sum``."""
    return "".join(f"{file_digest(Path(root) / name)}  {name}\n" for name in imported_files(script, root))


@cache  # many stages share most modules
def _imports(source: str) -> frozenset[str]:
    modules = set()
    todo: list[ast.AST] = [ast.parse(source)]
    while todo:
        node = todo.pop()
        if isinstance(node, ast.If) and getattr(node.test, "id", None) == "TYPE_CHECKING":
            continue  # never runs
        todo += ast.iter_child_nodes(node)
        if isinstance(node, ast.Import):
            modules |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            modules.add(node.module)
            modules |= {f"{node.module}.{alias.name}" for alias in node.names}
    return frozenset(module for module in modules if module.split(".")[0] in PACKAGES)


def _files(module: str, root: Path) -> list[Path]:
    """Return the module's file and the ``__init__.py`` of every package above it."""
    parts = module.split(".")
    candidates = [root.joinpath(*parts[:i], "__init__.py") for i in range(1, len(parts) + 1)]
    candidates.append(root.joinpath(*parts).with_suffix(".py"))
    return [path for path in candidates if path.is_file()]
