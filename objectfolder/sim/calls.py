"""Checks of what an environment gets: its objects, and calls, of which an agent may make any."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from objectfolder.base.checks import one_of, real_array, whole_number
from objectfolder.base.errors import ObjectFolderError, quoted
from objectfolder.base.materials import material
from objectfolder.objectfile.file import ObjectFile
from objectfolder.objectfile.samples import file_or_sample

MAX_PRESSURE = 1000.0  #: greatest sound pressure that is observed, Pa


def open_files(objects: "ObjectFile | str | Path | Sequence[ObjectFile | str | Path]") -> list[ObjectFile]:
    """Return the Object Files of an environment; a single one may stand for itself.

    Raises ObjectFolderError if there are none, one cannot be read, or two have one key.
    """
    given = [objects] if isinstance(objects, str | Path | ObjectFile) else [*objects]
    files = [object_file(one) for one in given]
    _require_different("object", [file.key for file in files], 1)
    return files


def distinct_materials(materials: str | Sequence[str], least: int = 1) -> list[str]:
    """Return the names of the materials of an environment; a single one may stand for itself.

    Raises ObjectFolderError if there are fewer than ``least``, one is unknown, or there is one twice.
    """
    names = [material(name).name for name in ([materials] if isinstance(materials, str) else materials)]
    _require_different("material", names, least)
    return names


def object_file(given: ObjectFile | str | Path) -> ObjectFile:
    """Return an Object File that is given as it is, by its path, or by the name of a sample."""
    if isinstance(given, ObjectFile):
        return given
    return ObjectFile.load(file_or_sample(Path(given)))


def check_render_mode(given: str | None) -> str | None:
    """Return a render mode: ``rgb_array``, pictures by ray casting, or None; else raise ObjectFolderError."""
    return None if given is None else one_of("render_mode", given, ("rgb_array",))


def check_resolution(given: Any) -> tuple[int, int]:
    """Return height and width of pictures; raise ObjectFolderError unless they are whole numbers above 0."""
    sides = [whole_number("resolution", side, 1) for side in (given if isinstance(given, Iterable) else [])]
    if len(sides) != 2:
        raise ObjectFolderError(f"resolution is {quoted(given)}, expected height and width, pixels")
    return sides[0], sides[1]


def check_actions(actions: Any, shape: tuple[int, ...]) -> np.ndarray:
    """Return actions as float64; raise ObjectFolderError unless they have the shape and are finite."""
    try:
        values = real_array("action", actions)
    except ObjectFolderError:
        values = np.full(0, np.nan)
    if values.shape != shape or not np.isfinite(values).all():
        rows = f"{shape[0]} rows of " if len(shape) > 1 else ""
        raise ObjectFolderError(
            f"action is {quoted(getattr(actions, 'tolist', lambda: actions)())}, expected {rows}{shape[-1]} "
            "finite numbers in [-1, 1]"
        )
    return values


def check_action(action: Any, count: int) -> int:
    """Return the number of an action; raise ObjectFolderError unless it is a whole one below ``count``."""
    values = np.asarray(action)
    if values.shape != () or values.dtype.kind not in "iu" or not 0 <= values < count:
        raise ObjectFolderError(f"action is {quoted(action)}, expected a whole number from 0 to {count - 1}")
    return int(values)


def refuse_options(options: dict[str, Any] | None) -> None:
    """Raise ObjectFolderError if a reset has options, of which the environments have none."""
    if options:
        raise ObjectFolderError(
            f"reset has options {quoted(options)}, but this environment has none; leave them out"
        )


def require_reset(begun: bool) -> None:
    """Raise ObjectFolderError if an environment was not reset before its first step or picture."""
    if not begun:
        raise ObjectFolderError("the environment was not reset; call reset() first")


def _require_different(what: str, names: list[str], least: int) -> None:
    """Raise ObjectFolderError unless there are enough names, and none of them twice."""
    if len({*names}) < max(least, len(names)):
        wanted = f"at least {'one' if least == 1 else 'two different'} {what}{'s' * (least > 1)}"
        raise ObjectFolderError(f"expected {wanted}, and none twice, got {quoted(names)}")
