"""Writes docs/licences.csv: packages, their licences, and the extras that bring them.

Usage: ``make licences``; it lists what is installed of constraints.txt.
"""

import csv
from importlib.metadata import PackageMetadata, PackageNotFoundError, metadata, requires
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

TABLE = Path(__file__).with_suffix(".csv")
USERS = ("build", "inspect", "bench", "rl", "hub", "ray", "s3")  # extras that make test installs


def dependencies(package: str, *extras: str) -> set[str]:
    """Normalized names of all packages that a package with extras brings here."""
    found: set[tuple[str, str]] = set()
    queue = [(package, extra) for extra in ("", *extras)]
    while queue:
        name, extra = queue.pop()
        for one in map(Requirement, requires(name) or ()):
            if one.marker is None or one.marker.evaluate({"extra": extra}):
                new = {(canonicalize_name(one.name), extra) for extra in ("", *one.extras)} - found
                found |= new
                queue += [pair for pair in new if is_installed(pair[0])]
    return {name for name, _ in found if is_installed(name)}


def is_installed(package: str) -> bool:
    try:
        return bool(metadata(package))
    except PackageNotFoundError:
        return False


def licence(package: PackageMetadata) -> str:
    """Licence as the package states it: an SPDX expression, classifiers, or one line of text."""
    classifiers = [
        text.split(" :: ")[-1]
        for text in package.get_all("Classifier") or ()
        if text.startswith("License :: ") and not text.endswith("OSI Approved")
    ]
    stated = package.get("License-Expression") or "; ".join(classifiers) or package.get("License", "").strip()
    return "see its file LICENSE" if "\n" in stated else stated


def table() -> list[tuple[str, str, str, str]]:
    """Rows, sorted by name."""
    base = dependencies("objectfolder")
    build = dependencies("objectfolder", "build") - base
    brought = {name: ["base"] for name in base} | {name: ["build"] for name in build}
    for extra in USERS[1:]:
        for name in dependencies("objectfolder", extra) - base - build:
            brought.setdefault(name, []).append(extra)
    for name in dependencies("objectfolder", "dev") - {"objectfolder"}:
        brought.setdefault(name, ["dev"])
    rows = []
    for name in sorted(brought):
        about = metadata(name)
        version = about["Version"].partition("+")[0]
        rows.append((name, version, licence(about), ", ".join(brought[name])))
    return rows


if __name__ == "__main__":
    with TABLE.open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([("package", "version", "licence", "for"), *table()])
