"""Checks of the dimensions that a caller asks for."""

import math

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
    """Raise `ObjectFolderError` unless `texture_size` is a whole number of texels from 64 to 8192."""
    if not isinstance(texture_size, int) or isinstance(texture_size, bool) or not 64 <= texture_size <= 8192:
        raise ObjectFolderError(
            f"{generator}: texture_size={texture_size!r}: expected a whole number of texels, 64 to 8192"
        )
