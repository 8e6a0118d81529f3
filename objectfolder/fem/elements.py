"""What a solid can be divided into, by the names that ``params.yaml`` uses."""

from collections.abc import Sequence
from dataclasses import fields
from typing import Any, Literal, get_args

import numpy as np

from objectfolder.errors import ObjectFolderError
from objectfolder.fem.adaptive import adaptive_cut_cells
from objectfolder.fem.cutcell import CutCells
from objectfolder.fem.elasticity import Solid
from objectfolder.fem.tetrahedra import Tetrahedra, tetrahedra
from objectfolder.fem.voxel import Voxels, voxels

#: Kinds of finite elements.
Element = Literal["cut_cell_hex20", "hex8", "hex8_incompatible", "tet10"]


def discretize(
    vertices: np.ndarray,
    faces: np.ndarray,
    element: Element,
    resolutions: Sequence[int],
    subdivisions: int,
    max_degrees_of_freedom: int,
    name: str = "mesh",
) -> Solid:
    """Divide a closed surface's inside into elements.

    Parameters
    ----------
    vertices : (V, 3) array, unit frame
    faces : (F, 3) int array
    element : str
        One of `Element`.
    resolutions : list of int
        Elements along the longest side, finest first: the first under the size is taken, else the last.
    subdivisions : int
        Of cut cells, along each side.
    max_degrees_of_freedom : int
    name : str
        Named in errors.

    Raises
    ------
    ObjectFolderError
        If the element is unknown, or the solid is in several pieces or too thin for it.
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


def stored(solid: Solid) -> dict[str, Any]:
    """Return the arrays of ``solid.npz``."""
    kind = next(name for name, cls in _CLASSES.items() if isinstance(solid, cls))
    return {"kind": np.array(kind), **vars(solid)}


def restored(arrays: dict[str, np.ndarray]) -> Solid:
    """Return the solid that ``solid.npz`` holds.

    Raises
    ------
    ObjectFolderError
        If it holds an element that is not known.
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
