"""The list in a folder of meshes that says what each object is made of: materials.csv or materials.yaml."""

import csv
import unicodedata
from collections.abc import Sequence
from contextlib import suppress
from math import inf
from pathlib import Path
from typing import Any

from objectfolder.base.checks import one_line
from objectfolder.base.errors import ObjectFolderError, quoted
from objectfolder.base.yamlfile import is_yaml_name, read_yaml

LISTS = ("materials.csv", "materials.yaml", "materials.yml")
#: Columns of materials.csv, in any order, and what their cells hold; "license" is "licence".
COLUMNS = {
    "name": "a file, subfolder or key",
    "material": "a material or its file",
    "size": "metres above 0, such as 0.112, or nothing",
    "up": "y, z or nothing",
    "wall": "metres above 0, such as 0.002, or nothing",
    "mass": "kilograms above 0, such as 0.118, or nothing",
    "shell": "metres above 0, such as 0.002, or nothing",
    "licence": "a licence such as CC-BY-4.0",
    "author": "who is to be named",
    "source": "title and address of the mesh",
}
#: Other names of columns in tables of objects.
ALIASES = {"key": "name", "object": "name", "longest_side_m": "size", "scale": "size", "license": "licence"}


def read_materials(folder: Path) -> dict[str, dict[str, Any]]:
    """Read the list of a folder, if it has one: by file, subfolder or key, the values of columns.

    Cells that are empty are left out. Raises ObjectFolderError if there are two lists, or a line or value of
    one is not as `COLUMNS` says.
    """
    lists = [folder / name for name in LISTS if (folder / name).is_file()]
    if len(lists) > 1:
        raise ObjectFolderError(f"{' and '.join(map(str, lists))} both assign materials; keep one")
    if not lists:
        return {}
    path = lists[0]
    expected = f"a table of {', '.join(COLUMNS)}" if path.suffix == ".csv" else "lines `name: material`"
    try:
        if path.suffix == ".csv":
            values: Any = _csv_rows(path)
        else:
            values = read_yaml(path)
            values = {n: {"material": v} for n, v in values.items()} if isinstance(values, dict) else values
    except ObjectFolderError:
        raise
    except (ValueError, csv.Error) as error:
        raise ObjectFolderError(f"{path} cannot be read: {error}; expected {expected}") from error
    if not isinstance(values, dict):
        raise ObjectFolderError(f"{path} holds {type(values).__name__}; expected {expected}")
    assigned = {}
    for name, fields in values.items():
        if "material" in fields:
            value = fields["material"]
            if isinstance(value, dict | list):
                raise ObjectFolderError(f"{path}: {quoted(name)} is {quoted(value)}; expected {expected}")
            fields["material"] = str(folder / str(value)) if is_yaml_name(value) else str(value)
        # File systems may have names in decomposed Unicode.
        assigned[unicodedata.normalize("NFC", str(name))] = fields
    return assigned


def read_objects(path: Path) -> dict[str, dict[str, Any]]:
    """Read a table of objects, such as objects.csv of a collection: by file or folder, the values of columns.

    Columns are those of `COLUMNS`, also by the names of `ALIASES`, and ``mesh``, a path from the table's
    folder; others are left out. Raises ObjectFolderError if it cannot be read, names no objects, or a value
    is not as `COLUMNS` says.
    """
    expected = f"a table whose first line names its columns, name and others of {', '.join(COLUMNS)}"
    try:
        lines = list(csv.DictReader(path.read_text(encoding="utf-8-sig").splitlines()))
    except (OSError, ValueError, csv.Error) as error:
        raise ObjectFolderError(f"{path} cannot be read: {error}; expected {expected}") from error
    rows: dict[str, dict[str, Any]] = {}
    for number, line in enumerate(lines, 2):
        texts = {ALIASES.get(column.lower(), column.lower()): text for column, text in line.items() if column}
        texts |= {ALIASES[column]: line[column] for column in ("key", "object") if line.get(column)}
        found = {column: (text or "").strip() for column, text in texts.items()}
        name = unicodedata.normalize("NFC", found.pop("name", ""))
        where = f"{path}, line {number}"
        if not name or name in rows:
            problem = f"has {quoted(name)} for the second time" if name else "has no name"
            raise ObjectFolderError(f"{where} {problem}; expected {expected}")
        known = (*COLUMNS, "mesh")
        rows[name] = {
            column: text if column == "mesh" else _cell(column, text, f"{where}: {column} of {quoted(name)}")
            for column, text in found.items()
            if text and column in known
        }
        material = rows[name].get("material")
        if is_yaml_name(material or ""):
            rows[name]["material"] = str(path.parent / str(material))
    if not rows:
        raise ObjectFolderError(f"{path} lists no objects; expected {expected}")
    return rows


def _csv_rows(path: Path) -> dict[str, dict[str, Any]]:
    """Read a table whose first line may name its columns; else they are name, material and perhaps mass."""
    lines = csv.reader(path.read_text(encoding="utf-8-sig").splitlines())
    columns: list[str] = []
    rows: dict[str, dict[str, Any]] = {}
    for row in lines:
        cells, where = [cell.strip() for cell in row], f"{path}, line {lines.line_num}"
        if not any(cells):
            continue
        if not columns and not rows:
            columns = _columns(cells, where)
            if columns:
                continue
        named = columns or ["name", "material", "mass"]
        if len(cells) > len(named) or (not columns and len(cells) < 2):
            expected = ",".join(columns) or "name,material` or `name,material,mass"
            raise ObjectFolderError(f"{where} is {quoted(','.join(row))}, expected `{expected}`")
        found = {column: text for column, text in zip(named, cells) if text}
        name = found.pop("name", "")
        rows[name] = {
            column: _cell(column, text, f"{where}: {column} of {quoted(name)}")
            for column, text in found.items()
        }
    return rows


def _columns(cells: Sequence[str], where: str) -> list[str]:
    """Return the columns that the first line of a table names; none if it is a row."""
    names = ["licence" if cell.lower() == "license" else cell.lower() for cell in cells]
    if "name" not in names:
        return []
    for cell, name in zip(cells, names):
        if name not in COLUMNS or names.count(name) > 1:
            problem = "is there twice" if name in COLUMNS else "is unknown"
            raise ObjectFolderError(
                f"{where}: column {quoted(cell)} {problem}; expected each once of {', '.join(COLUMNS)}"
            )
    return names


def _cell(column: str, text: str, where: str) -> str | float:
    """Return the value of a cell that is not empty."""
    if column in ("material", "licence", "author", "source"):
        return one_line(where, text, 1000)
    with suppress(ValueError):
        if (column == "up" and text in ("y", "z")) or (column != "up" and 0 < float(text) < inf):
            return text if column == "up" else float(text)
    raise ObjectFolderError(f"{where} is {quoted(text)}, expected {COLUMNS[column]}")
