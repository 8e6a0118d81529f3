"""Procedural generators: parametric families of textured objects.

Most take ``finish``, ``color``, ``accent`` and ``seed`` of `objectfolder.shapes.finish.finish`,
and all ``texture_size``, the side of the texture in texels. A generator raises `ObjectFolderError` if an
option is unknown or a dimension does not fit the others.
"""

import inspect
from collections.abc import Callable
from typing import Any

from objectfolder.base.errors import ObjectFolderError
from objectfolder.mesh.textured import TexturedMesh
from objectfolder.shapes.airplane import airplane
from objectfolder.shapes.appliance import appliance
from objectfolder.shapes.bell import bell
from objectfolder.shapes.block import block
from objectfolder.shapes.die import die
from objectfolder.shapes.electronics import electronics
from objectfolder.shapes.furniture import shelf, stool, table
from objectfolder.shapes.hammer import hammer
from objectfolder.shapes.mug import mug
from objectfolder.shapes.pan import pan
from objectfolder.shapes.spoon import spoon
from objectfolder.shapes.teapot import teapot
from objectfolder.shapes.toy import toy
from objectfolder.shapes.vessels import bottle, bowl, cup, plate, vase
from objectfolder.shapes.wrench import wrench

__all__ = ["GENERATORS", "generate"]

#: Generators by name; all parameters have defaults, lengths are in metres.
GENERATORS: dict[str, Callable[..., TexturedMesh]] = {
    build.__name__: build
    for build in (
        *(airplane, appliance, bell, block, bottle, bowl, cup, die, electronics, hammer, mug, pan, plate),
        *(shelf, spoon, stool, table, teapot, toy, vase, wrench),
    )
}


def generate(generator: str, **parameters: Any) -> TexturedMesh:
    """Build an object with smooth normals and creases; equal parameters give equal bytes.

    Parameters
    ----------
    generator : str
        A key of `GENERATORS`.
    **parameters
        Parameters of the generator; see its docstring.

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
    return build(**parameters).with_smooth_normals()
