"""Pictures of meshes and cells, drawn off-screen with VTK."""

import ctypes.util
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.installation import install_command
from objectfolder.mesh.textured import TexturedMesh

if TYPE_CHECKING:
    import pyvista

VIEW_FROM = (0.55, -1.0, 0.55)  #: default direction from the object to the camera; z is up
CLAY = "#c9ccd1"


def draw_scene(
    add: Callable[["pyvista.Plotter"], Any],
    view_from: tuple[float, float, float] = VIEW_FROM,
    size: tuple[int, int] = (800, 800),
) -> np.ndarray:
    """Draw a scene on white and crop the picture to it; (H, W, 3) uint8.

    ``add`` adds meshes to the plotter, which looks from the direction ``view_from`` and has the size, width
    and height in pixels, before cropping. Raises ObjectFolderError if pyvista is not installed, or the
    machine has no OpenGL.
    """
    pyvista = _pyvista()
    from vtkmodules.vtkCommonCore import vtkLogger

    # Without an X server VTK warns before it falls back to EGL.
    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_OFF)
    plotter: Any = pyvista.Plotter(off_screen=True, window_size=list(size), lighting="light kit")
    try:
        # VTK's last fallback crashes the process if OSMesa is missing.
        software_only = plotter.render_window.GetClassName() == "vtkOSOpenGLRenderWindow"
        if software_only and ctypes.util.find_library("OSMesa") is None:
            raise ObjectFolderError(
                "VTK finds no OpenGL on this machine, neither X nor EGL; install Mesa's software renderer: "
                "`apt-get install libegl1 libgl1-mesa-dri`"
            )
        plotter.set_background("white")
        add(plotter)
        plotter.camera_position = [view_from, (0, 0, 0), (0, 0, 1)]
        plotter.reset_camera()
        plotter.enable_anti_aliasing("ssaa")
        return _crop(np.asarray(plotter.screenshot(return_img=True)))
    finally:
        plotter.close()


def triangles(vertices: np.ndarray, faces: np.ndarray) -> "pyvista.PolyData":
    """Return a VTK mesh of (V, 3) vertices and (F, 3) faces."""
    pyvista = _pyvista()
    return pyvista.PolyData.from_regular_faces(np.asarray(vertices, np.float64), faces)


def add_textured(plotter: "pyvista.Plotter", mesh: TexturedMesh) -> None:
    """Add a mesh with its texture or vertex colours."""
    pyvista = _pyvista()
    poly = triangles(mesh.vertices, mesh.faces)
    if mesh.uv is not None and mesh.texture is not None:
        poly.active_texture_coordinates = mesh.uv
        plotter.add_mesh(poly, texture=pyvista.Texture(mesh.texture))
    elif mesh.vertex_colors is not None:
        poly.point_data["color"] = mesh.vertex_colors
        plotter.add_mesh(poly, scalars="color", rgb=True)
    else:
        plotter.add_mesh(poly, color=CLAY)


def hexahedra(
    index: np.ndarray, lower: np.ndarray, size: float, width: np.ndarray
) -> "pyvista.UnstructuredGrid":
    """Return a VTK mesh of cubic cells that share their corners.

    ``index`` (E, 3) is the position of each cell in the grid, whose lower corner is ``lower``; ``size`` is
    the side of a cell, and ``width`` (E,) that of each cube, in cells.
    """
    pyvista = _pyvista()
    # Corners in VTK's order: around the bottom, then around the top.
    around = [(0, 0), (1, 0), (1, 1), (0, 1)]
    corner = np.array([(x, y, z) for z in (0, 1) for x, y in around])
    corners = (index[:, None] + width[:, None, None] * corner).reshape(-1, 3)
    nodes, cells = np.unique(corners, axis=0, return_inverse=True)
    return pyvista.UnstructuredGrid({pyvista.CellType.HEXAHEDRON: cells.reshape(-1, 8)}, nodes * size + lower)


def _pyvista() -> Any:
    try:
        import pyvista
    except ModuleNotFoundError as error:
        missing = f"{error.name} is not installed; this needs: {install_command('inspect')}"
        raise ObjectFolderError(missing) from error
    return pyvista


def _crop(image: np.ndarray, margin: int = 10) -> np.ndarray:
    """Crop the white border."""
    drawn = np.any(image < 255, axis=-1)
    rows, columns = np.flatnonzero(drawn.any(1)), np.flatnonzero(drawn.any(0))
    if len(rows) == 0:
        return image
    top, left = max(rows[0] - margin, 0), max(columns[0] - margin, 0)
    return image[top : rows[-1] + margin + 1, left : columns[-1] + margin + 1]
