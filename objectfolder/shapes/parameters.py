"""What is asked of a generator, and checks of it."""

import inspect
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import wraps
from typing import Annotated, Any

from objectfolder.base.errors import ObjectFolderError
from objectfolder.mesh.textured import TexturedMesh

Size = Annotated[float, "positive and finite"]  #: a dimension that `generator` checks


@dataclass(frozen=True)
class Order:
    """What generators have in common; its checks raise `ObjectFolderError`, which names both.

    ``texture_size`` is a whole number of texels from 64 to 8192.
    """

    generator: str
    texture_size: int
    finish: str = ""
    color: str | None = None
    accent: str | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        if not _whole(self.texture_size) or not 64 <= self.texture_size <= 8192:
            self.refuse("texture_size", self.texture_size, "a whole number of texels, 64 to 8192")

    def positive(self, **dimensions: float) -> None:
        """Raise unless every dimension is a finite number above zero."""
        for name, value in dimensions.items():
            if not _number(value) or not math.isfinite(value) or value <= 0:
                self.refuse(name, value, "a positive, finite number")

    def between(self, low: float, high: float, why: str, **dimensions: float) -> None:
        """Raise unless every dimension is a number in the closed range [low, high]."""
        for name, value in dimensions.items():
            if not _number(value) or not low <= value <= high:
                beside = f"change {name} or the dimensions beside it"
                self.refuse(name, value, f"{low:.4g} to {high:.4g}, {why}; {beside}")

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


def generator(
    finish: str | None = None, color: str | None = None, accent: str | None = None
) -> Callable[[Callable[..., TexturedMesh]], Callable[..., TexturedMesh]]:
    """Make a generator of a function of an `Order` and dimensions; those annotated as `Size` are checked.

    It also takes ``texture_size``, and before it, if there is a default of ``finish``, what `Order` has.
    """
    looks = {"finish": finish, "color": color, "accent": accent, "seed": 0} if finish else {}
    kind = inspect.Parameter.POSITIONAL_OR_KEYWORD
    shared = {**looks, "texture_size": 1024}
    types = Order.__annotations__
    last = [inspect.Parameter(name, kind, default=shared[name], annotation=types[name]) for name in shared]

    def decorate(build: Callable[..., TexturedMesh]) -> Callable[..., TexturedMesh]:
        own = [*inspect.signature(build).parameters.values()][1:]
        sizes = [dimension.name for dimension in own if dimension.annotation == Size]
        told = [one.replace(annotation=float) if one.name in sizes else one for one in own]
        signature = inspect.Signature([*told, *last], return_annotation=TexturedMesh)

        @wraps(build)
        def made(*args: Any, **given: Any) -> TexturedMesh:
            bound = signature.bind(*args, **given)
            bound.apply_defaults()
            values = bound.arguments
            order = Order(build.__name__, **{name: values.pop(name) for name in shared})
            order.positive(**{name: values[name] for name in sizes})
            return build(order, **values)

        made.__signature__, made.__annotations__ = signature, {}  # type: ignore[attr-defined]
        return made

    return decorate


def _number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _whole(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)
