"""Find the project files that a stage runs, from its source, and digest what runs of them.

The digest of a module is that of its syntax tree without docstrings: comments, layout and prose make nothing
stale.
"""

import ast
import hashlib
import inspect
import re
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.io import file_digest
from objectfolder.base.yamlfile import is_yaml_name
from objectfolder.workspace.installed import INSTALLED, PACKAGE, PROFILES, SENSORS, located, runs_installed
from objectfolder.workspace.layout import MATERIALS
from objectfolder.workspace.params import PARAMS_FILE, read

_DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
#: Text that names modules which are imported by name, such as all nets of a sense.
_PATTERN = re.compile(rf"{PACKAGE}(\.\w+)*\.\*\w+")
PACKAGES = (PACKAGE, "stages")  #: packages of the project
#: Files and folders of the package that stages read; a workspace without the package depends on digests.
DATA = (f"{PACKAGE}/benchmarks/data", f"{PACKAGE}/stored/objectfile.schema.json", PROFILES)


def imported_files(script: str | Path, root: str | Path = ".") -> list[str]:
    """List the project files that a script imports, directly or indirectly, and the script itself; sorted.

    They and ``script`` are relative to the workspace ``root``, or to the directory that contains the package
    if the workspace has none; empty files (``__init__.py``) are left out. Raises ObjectFolderError if a file
    is not Python, or a stage imports a module of the workspace beside its packages, where the pipeline would
    not see changes.
    """
    todo, found = [Path(script).as_posix()], set()
    while todo:
        name = todo.pop()
        if name in found:
            continue
        found.add(name)
        for module in _modules(name, root):
            todo += [file for file in _files(module, root) if located(file, root).stat().st_size > 0]
    return sorted(found)


def digests(script: str | Path, root: str | Path = ".") -> str:
    """Return the digest and the name of every file that a script runs, one per line."""
    return _digests(imported_files(script, root), root)


@cache
def code_digest(function: Callable[..., Any]) -> str:
    """Return the SHA-256 of what a function's module runs of this package; hexadecimal."""
    script = Path(inspect.getfile(function)).resolve().relative_to(INSTALLED)
    return hashlib.sha256(digests(script, INSTALLED).encode()).hexdigest()


def code_text(name: str, root: str | Path = ".") -> str | None:
    """Return the digests of what a stage imports, or of files of the package that stages read.

    ``name``: a stage, a file or folder in `DATA`, or the material of an object, ``materials/KEY``. Returns a
    digest and a name per line; None if there is no such stage, file or object.
    """
    folder, _, key = name.partition("/")
    if folder == MATERIALS:
        file = _file_of_material(key, root)
        return None if file is None else _digests([file], root)
    if "/" not in name:
        script = f"stages/{name}.py"
        return digests(script, root) if located(script, root).is_file() else None
    path = located(name, root)
    if not path.exists():
        return None
    return _digests([name] if path.is_file() else _names_below(name, root), root)


def _file_of_material(key: str, root: str | Path) -> str | None:
    """Return the file of the material that an object names; None if there is none."""
    path = Path(root, PARAMS_FILE)
    entry = _objects(path, path.read_bytes() if path.is_file() else b"").get(key)
    described = entry.get("material") if isinstance(entry, dict) else None
    name = described.get("base") if isinstance(described, dict) else described
    file = str(name) if is_yaml_name(name) else f"{PACKAGE}/base/{MATERIALS}/{str(name).lower()}.yaml"
    return file if located(file, root).is_file() else None


@cache  # for all objects, while the file says the same
def _objects(path: Path, _content: bytes) -> dict[str, Any]:
    objects: dict[str, Any] = read(path)["objects"]
    return objects


def content_digest(path: Path) -> str:
    """Return the SHA-256 of what runs of a module, or of all of another file; hexadecimal.

    Raises ObjectFolderError if it does not exist; SyntaxError or ValueError if it should be a module, but is
    not Python.
    """
    if path.suffix != ".py" or not path.is_file():
        return file_digest(path)
    return source_digest(path.read_text(encoding="utf-8"))


def source_digest(source: str) -> str:
    """Return the SHA-256 of what runs of a module's source: its syntax tree without docstrings."""
    return _parsed(source)[0]


def data_names(root: str | Path = ".") -> list[str]:
    """List `DATA` and the files in its folders."""
    return sorted({*DATA, *(inner for name in DATA for inner in _names_below(name, root))})


def _digests(names: list[str], root: str | Path) -> str:
    return "".join(f"{content_digest(located(name, root))}  {name}\n" for name in names)


def _names_below(name: str, root: str | Path) -> list[str]:
    folder = located(name, root)
    files = {path.relative_to(folder) for path in folder.rglob("*") if path.is_file()}
    own = Path(root, SENSORS)
    if name == PROFILES and runs_installed(root):
        files |= {path.relative_to(own) for path in own.glob("[!.]*") if path.is_file()}
    return sorted(f"{name}/{file.as_posix()}" for file in files if "__pycache__" not in file.parts)


def _modules(name: str, root: str | Path) -> set[str]:
    try:
        modules = _imports(located(name, root).read_text(encoding="utf-8"), ".".join(Path(name).parts[:-1]))
    except (SyntaxError, UnicodeDecodeError) as error:
        line = f", line {error.lineno}: {error.msg}" if isinstance(error, SyntaxError) else f": {error}"
        raise ObjectFolderError(f"{name}{line}; correct it") from error
    if not name.startswith(f"{PACKAGE}/"):  # an installed package has its libraries in the same folder
        _require_seen(name, modules, root)
    return {module for module in modules if module.partition(".")[0] in PACKAGES}


def _require_seen(name: str, modules: set[str], root: str | Path) -> None:
    for top in sorted({module.partition(".")[0] for module in modules} - {*PACKAGES}):
        if Path(root, f"{top}.py").is_file() or Path(root, top, "__init__.py").is_file():
            raise ObjectFolderError(
                f"{name} imports {top} of the workspace, whose changes the pipeline would not see: "
                f"move it to stages/, and import stages.{top}"
            )


def _imports(source: str, package: str) -> set[str]:
    """Return all modules that a source in a package imports, and names in them, which may be modules."""
    modules = set()
    for level, name in _parsed(source)[1]:
        above = package.split(".")[: 1 - level or None] if level else []
        modules.add(".".join([*above, *([name] if name else [])]))
    return modules


@cache  # many stages share most modules
def _parsed(source: str) -> tuple[str, frozenset[tuple[int, str]]]:
    """Return the digest of what runs of a source, and its imports as level of a relative one and name."""
    tree = ast.parse(source)
    words: list[str] = []
    _spell(tree, words)
    digest = hashlib.sha256("\0".join(words).encode(errors="surrogatepass")).hexdigest()
    imports: set[tuple[int, str]] = set()
    todo: list[ast.AST] = [tree]
    while todo:
        node = todo.pop()
        if isinstance(node, ast.If) and getattr(node.test, "id", None) == "TYPE_CHECKING":
            continue  # never runs
        todo += ast.iter_child_nodes(node)
        if isinstance(node, ast.Import):
            imports |= {(0, alias.name) for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            module = node.module or ""
            imports |= {(node.level, name) for name in (module, *(f"{module}.{a.name}" for a in node.names))}
        elif isinstance(node, ast.Constant) and _PATTERN.fullmatch(str(node.value)):
            imports.add((0, str(node.value)))
    return digest, frozenset((level, name.lstrip(".")) for level, name in imports)


def _spell(node: ast.AST, words: list[str]) -> None:
    """Append the words of a syntax tree, alike for all versions of Python, without docstrings."""
    words += [type(node).__name__, "{"]
    for name, value in ast.iter_fields(node):
        values = value if isinstance(value, list) else [value]
        if name == "body" and isinstance(node, _DOCUMENTED):
            values = values[ast.get_docstring(node, clean=False) is not None :]
        if value is None or not values:  # newer versions have more fields, empty in older code
            continue
        words += [name, "("]
        for inner in values:
            if isinstance(inner, ast.AST):
                _spell(inner, words)
            else:
                words.append(repr(inner))
        words.append(")")
    words.append("}")


def _files(module: str, root: str | Path = ".") -> list[str]:
    """Return the module's file and the ``__init__.py`` of every package above it, or files of a pattern."""
    parts = module.split(".")
    names = ["/".join((*parts[:i], "__init__.py")) for i in range(1, len(parts) + 1)]
    folder = "/".join(parts[:-1])
    found = sorted(located(folder, root).glob(f"{parts[-1]}.py")) if "*" in parts[-1] else []
    names += [f"{folder}/{file.name}" for file in found] or ["/".join(parts) + ".py"]
    return [name for name in names if located(name, root).is_file()]
