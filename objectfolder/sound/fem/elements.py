"""Choice of the element by its name in ``params.yaml``, and storage of solids."""

from collections.abc import Sequence
from dataclasses import fields
from typing import Any, get_args

import numpy as np

from objectfolder.base.errors import ObjectFolderError
from objectfolder.sound.fem.adaptive import adaptive_cut_cells
from objectfolder.sound.fem.cutcell import CutCells
from objectfolder.sound.fem.elasticity import Solid
from objectfolder.sound.fem.settings import Element
from objectfolder.sound.fem.tetrahedra import Tetrahedra, tetrahedra
from objectfolder.sound.fem.voxel import Voxels, voxels


def discretize(
    vertices: np.ndarray,
    faces: np.ndarray,
    element: Element,
    resolutions: Sequence[int],
    subdivisions: int,
    max_degrees_of_freedom: int,
    name: str = "mesh",
) -> Solid:
    """Divide the inside of a closed surface, (V, 3) in the unit frame and (F, 3), into elements.

    Resolutions, elements along the longest side, are listed finest first: the first within the size limit is
    used, else the last. Cut cells have so many subdivisions along each side. Raises ObjectFolderError, with
    the object's name, if the element is not one of `Element`, or the solid is in several pieces or too thin.
    """
    if element not in get_args(Element):
        raise ObjectFolderError(
            f"{name}: unknown element {element!r}; expected one of {', '.join(get_args(Element))}"
        )
    if element == "cut_cell_hex20":
        return adaptive_cut_cells(vertices, faces, resolutions, subdivisions, max_degrees_of_freedom, name)
    for resolution in resolutions:
        solid: Solid
        if element == "tet10":
            solid = tetrahedra(vertices, faces, resolution, name)
        else:
            solid = voxels(vertices, faces, resolution, element == "hex8_incompatible", name)
        if solid.degrees_of_freedom <= max_degrees_of_freedom:
            break
    return solid


def solid_arrays(solid: Solid) -> dict[str, Any]:
    """Return the arrays of ``solid.npz``."""
    kind = next(name for name, cls in _CLASSES.items() if isinstance(solid, cls))
    return {"kind": np.array(kind), **vars(solid)}


def solid_from_arrays(arrays: dict[str, np.ndarray]) -> Solid:
    """Return the solid stored in the arrays of ``solid.npz``.

    Raises ObjectFolderError if its element is unknown.
    """
    kind = str(arrays.get("kind"))
    if kind not in _CLASSES:
        raise ObjectFolderError(
            f"solid.npz holds {kind!r}, expected one of {', '.join(_CLASSES)}; repeat the voxelize stage"
        )
    cls = _CLASSES[kind]
    values = {field.name: arrays[field.name] for field in fields(cls)}
    return cls(**{name: value if value.ndim else value.item() for name, value in values.items()})


_CLASSES: dict[str, type] = {"cut cells": CutCells, "voxels": Voxels, "tetrahedra": Tetrahedra}
