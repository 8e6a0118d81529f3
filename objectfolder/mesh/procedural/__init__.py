"""Generators of starter objects with their own textures."""

import inspect
from collections.abc import Callable
from typing import Any

from objectfolder.errors import ObjectFolderError
from objectfolder.mesh.procedural.bell import bell
from objectfolder.mesh.procedural.die import die
from objectfolder.mesh.procedural.mug import mug
from objectfolder.mesh.textured import TexturedMesh

__all__ = ["GENERATORS", "generate"]

#: What `generate` can make; all parameters have defaults and lengths are in metres.
GENERATORS: dict[str, Callable[..., TexturedMesh]] = {"mug": mug, "die": die, "bell": bell}


def generate(generator: str, **parameters: Any) -> TexturedMesh:
    """Build an object; the same parameters give the same bytes.

    Parameters
    ----------
    generator : str
        A key of `GENERATORS`.
    **parameters
        Of that generator; see its docstring.

    Raises
    ------
    ObjectFolderError
        If the generator or a parameter is unknown, or a dimension is impossible.
    """
    build = GENERATORS.get(generator)
    if build is None:
        raise ObjectFolderError(f"unknown generator {generator!r}: expected one of {', '.join(GENERATORS)}")
    known = inspect.signature(build).parameters
    for name in parameters:
        if name not in known:
            raise ObjectFolderError(
                f"{generator}: unknown parameter {name!r}: expected one of {', '.join(known)}"
            )
    return build(**parameters)
