"""Procedural generators: parametric families of textured objects, one module each.

Most take ``finish``, ``color``, ``accent`` and ``seed`` of `objectfolder.mesh.procedural.finish.finish`,
and all ``texture_size``, the side of the texture in texels. A generator raises `ObjectFolderError` if an
option is unknown or a dimension does not fit the others.
"""

import inspect
from collections.abc import Callable
from typing import Any

from objectfolder.errors import ObjectFolderError
from objectfolder.mesh.procedural.airplane import airplane
from objectfolder.mesh.procedural.appliance import appliance
from objectfolder.mesh.procedural.bell import bell
from objectfolder.mesh.procedural.block import block
from objectfolder.mesh.procedural.bottle import bottle
from objectfolder.mesh.procedural.bowl import bowl
from objectfolder.mesh.procedural.cup import cup
from objectfolder.mesh.procedural.die import die
from objectfolder.mesh.procedural.electronics import electronics
from objectfolder.mesh.procedural.hammer import hammer
from objectfolder.mesh.procedural.mug import mug
from objectfolder.mesh.procedural.pan import pan
from objectfolder.mesh.procedural.plate import plate
from objectfolder.mesh.procedural.shelf import shelf
from objectfolder.mesh.procedural.spoon import spoon
from objectfolder.mesh.procedural.stool import stool
from objectfolder.mesh.procedural.table import table
from objectfolder.mesh.procedural.teapot import teapot
from objectfolder.mesh.procedural.toy import toy
from objectfolder.mesh.procedural.vase import vase
from objectfolder.mesh.procedural.wrench import wrench
from objectfolder.mesh.textured import TexturedMesh

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
