"""Which project files a stage imports, directly or not, found in the source without running it."""

import ast
from pathlib import Path

PACKAGES = ("objectfolder", "stages")


def imported_files(script: Path, root: Path) -> set[str]:
    """Project files (relative to root) that importing a script runs; empty ``__init__.py`` left out."""
    todo, found = [script], set()
    while todo:
        path = todo.pop()
        name = path.relative_to(root).as_posix()
        if name in found:
            continue
        found.add(name)
        for module in _imports(path):
            todo += [p for p in _files(module, root) if p.stat().st_size > 0]
    return found


def _imports(path: Path) -> set[str]:
    modules = set()
    todo: list[ast.AST] = [ast.parse(path.read_text())]
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
    return {m for m in modules if m.split(".")[0] in PACKAGES}


def _files(module: str, root: Path) -> list[Path]:
    """The module's file and the ``__init__.py`` of every package above it."""
    parts = module.split(".")
    candidates = [root.joinpath(*parts[:i], "__init__.py") for i in range(1, len(parts) + 1)]
    candidates.append(root.joinpath(*parts).with_suffix(".py"))
    return [path for path in candidates if path.is_file()]
