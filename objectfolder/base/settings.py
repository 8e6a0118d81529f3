"""Constraints on settings: types of the fields of the dataclasses that are sections of ``params.yaml``.

A section of ``params.yaml`` is a frozen dataclass beside the code that uses it. These types only annotate it;
`objectfolder.workspace.params` reads the file and checks them.
"""

from collections.abc import Callable
from typing import Annotated, Literal, TypeVar

from annotated_types import Ge, Gt, Interval, MultipleOf

Config = TypeVar("Config", bound=type)


def section(name: str) -> Callable[[Config], Config]:
    """Name the section of ``params.yaml`` that a dataclass is."""

    def mark(config: Config) -> Config:
        config.section = name  # type: ignore[attr-defined]
        return config

    return mark


Count = Annotated[int, Ge(1)]
Even = Annotated[int, Ge(2), MultipleOf(2)]
Positive = Annotated[float, Gt(0)]
NonNegative = Annotated[float, Ge(0)]
Batch = Annotated[int, Ge(2)]
Octaves = Annotated[int, Interval(ge=0, le=16)]  #: of a positional encoding
Share = Annotated[float, Interval(ge=0, le=1)]
Precision = Literal["float32", "bfloat16"]  #: of matrix products in training
Discount = Annotated[float, Interval(gt=0, le=1)]
