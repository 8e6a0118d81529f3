"""Checks of what an environment gets: its objects, and calls, of which an agent may make any."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from objectfolder.checks import real_array
from objectfolder.errors import ObjectFolderError, quoted
from objectfolder.objectfile.file import ObjectFile
from objectfolder.objectfile.samples import file_or_sample

KEPT = ("_np_random", "_np_random_seed", "spec")  #: attributes of gymnasium's that a copy keeps


def opened(objects: "ObjectFile | str | Path | Sequence[ObjectFile | str | Path]") -> list[ObjectFile]:
    """Return the Object Files of an environment; see `object_file`. A single one may stand for itself.

    Raises
    ------
    ObjectFolderError
        If there are none, or one cannot be read.
    """
    given = [objects] if isinstance(objects, str | Path | ObjectFile) else [*objects]
    if not given:
        raise ObjectFolderError("expected at least one object")
    return [object_file(one) for one in given]


def object_file(given: ObjectFile | str | Path) -> ObjectFile:
    """Return an Object File that is given as it is, by its path, or by the name of a sample."""
    if isinstance(given, ObjectFile):
        return given
    return ObjectFile.load(file_or_sample(Path(given)))


def finite_actions(actions: Any, shape: tuple[int, ...]) -> np.ndarray:
    """Return actions as float64.

    Raises
    ------
    ObjectFolderError
        If they do not have the shape, or are not finite numbers.
    """
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


def discrete_action(action: Any, count: int) -> int:
    """Return the number of an action.

    Raises
    ------
    ObjectFolderError
        If it is not a whole number below ``count``.
    """
    values = np.asarray(action)
    if values.shape != () or values.dtype.kind not in "iu" or not 0 <= values < count:
        raise ObjectFolderError(f"action is {quoted(action)}, expected a whole number from 0 to {count - 1}")
    return int(values)


def no_options(options: dict[str, Any] | None) -> None:
    """Raise ObjectFolderError if a reset has options, of which the environments have none."""
    if options:
        raise ObjectFolderError(
            f"reset has options {quoted(options)}, but this environment has none; leave them out"
        )


def started(begun: bool) -> None:
    """Raise ObjectFolderError if an environment was not reset before its first step or picture."""
    if not begun:
        raise ObjectFolderError("the environment was not reset; call reset() first")
