"""Checks of the options that a caller asks for, beside dimensions."""

from collections.abc import Sequence

from objectfolder.errors import ObjectFolderError


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
    """Raise `ObjectFolderError` unless the dimension is a number from 0 to `high`."""
    for name, value in dimension.items():
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if not number or not 0 <= value <= high:
            raise ObjectFolderError(
                f"{generator}: {name}={value!r}: expected 0 to {high:.4g}, {why}; "
                f"change {name} or the dimensions beside it"
            )
