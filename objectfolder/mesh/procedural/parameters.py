"""Checks of the generators' parameters."""

import math
from collections.abc import Sequence

from objectfolder.errors import ObjectFolderError


def require_positive(generator: str, **dimensions: float) -> None:
    """Raise `ObjectFolderError` unless every dimension is a finite number above zero."""
    for name, value in dimensions.items():
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if not number or not math.isfinite(value) or value <= 0:
            raise ObjectFolderError(f"{generator}: {name}={value!r}: expected a positive, finite number")


def require_between(generator: str, low: float, high: float, why: str, **dimension: float) -> None:
    """Raise `ObjectFolderError` unless the one dimension lies in the closed range [low, high]."""
    for name, value in dimension.items():
        if not low <= value <= high:
            raise ObjectFolderError(
                f"{generator}: {name}={value!r}: expected {low:.4g} to {high:.4g}, {why}; "
                f"change {name} or the dimensions beside it"
            )


def require_texture_size(generator: str, texture_size: int) -> None:
    """Raise `ObjectFolderError` unless ``texture_size`` is a whole number of texels from 64 to 8192."""
    if not isinstance(texture_size, int) or isinstance(texture_size, bool) or not 64 <= texture_size <= 8192:
        raise ObjectFolderError(
            f"{generator}: texture_size={texture_size!r}: expected a whole number of texels, 64 to 8192"
        )


def require_choice(generator: str, choices: Sequence[str], **option: str) -> None:
    """Raise `ObjectFolderError` unless the option is one of the choices."""
    for name, value in option.items():
        if value not in choices:
            raise ObjectFolderError(f"{generator}: {name}={value!r}: expected one of {', '.join(choices)}")


def require_count(generator: str, low: int, high: int, **count: int) -> None:
    """Raise `ObjectFolderError` unless the count is a whole number in the closed range [low, high]."""
    for name, value in count.items():
        if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
            raise ObjectFolderError(
                f"{generator}: {name}={value!r}: expected a whole number from {low} to {high}"
            )


def require_not_negative(generator: str, high: float, why: str, **dimension: float) -> None:
    """Raise `ObjectFolderError` unless the dimension is a number from 0 to ``high``."""
    for name, value in dimension.items():
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if not number or not 0 <= value <= high:
            raise ObjectFolderError(
                f"{generator}: {name}={value!r}: expected 0 to {high:.4g}, {why}; "
                f"change {name} or the dimensions beside it"
            )
