"""Checks of the generators' parameters."""

import math
from collections.abc import Sequence

from objectfolder.base.errors import ObjectFolderError


class Checks:
    """Checks of a generator's parameters; all raise `ObjectFolderError`, which names both.

    Every generator has a ``texture_size``, a whole number of texels from 64 to 8192.
    """

    def __init__(self, generator: str, texture_size: int):
        self.generator = generator
        if not _whole(texture_size) or not 64 <= texture_size <= 8192:
            self.refuse("texture_size", texture_size, "a whole number of texels, 64 to 8192")

    def positive(self, **dimensions: float) -> None:
        """Raise unless every dimension is a finite number above zero."""
        for name, value in dimensions.items():
            if not _number(value) or not math.isfinite(value) or value <= 0:
                self.refuse(name, value, "a positive, finite number")

    def between(self, low: float, high: float, why: str, **dimensions: float) -> None:
        """Raise unless every dimension lies in the closed range [low, high]."""
        for name, value in dimensions.items():
            if not low <= value <= high:
                beside = f"change {name} or the dimensions beside it"
                self.refuse(name, value, f"{low:.4g} to {high:.4g}, {why}; {beside}")

    def not_negative(self, high: float, why: str, **dimensions: float) -> None:
        """Raise unless every dimension is a number from 0 to ``high``."""
        for name, value in dimensions.items():
            if not _number(value) or not 0 <= value <= high:
                beside = f"change {name} or the dimensions beside it"
                self.refuse(name, value, f"0 to {high:.4g}, {why}; {beside}")

    def choice(self, choices: Sequence[str], **options: str) -> None:
        """Raise unless the option is one of the choices."""
        for name, value in options.items():
            if value not in choices:
                self.refuse(name, value, f"one of {', '.join(choices)}")

    def count(self, low: int, high: int, **counts: int) -> None:
        """Raise unless the count is a whole number in the closed range [low, high]."""
        for name, value in counts.items():
            if not _whole(value) or not low <= value <= high:
                self.refuse(name, value, f"a whole number from {low} to {high}")

    def refuse(self, name: str, value: object, expected: str) -> None:
        """Raise an error that says what was expected."""
        raise ObjectFolderError(f"{self.generator}: {name}={value!r}: expected {expected}")


def _number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _whole(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)
