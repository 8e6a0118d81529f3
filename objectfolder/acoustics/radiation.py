"""Sound that each vibration mode of an object sends out."""

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from annotated_types import Ge

from objectfolder.acoustics.boundary import Boundary
from objectfolder.acoustics.farfield import MAX_ORDER, FarField, pack_far_field
from objectfolder.acoustics.harmonics import Radiator, degrees
from objectfolder.acoustics.meshing import (
    carried,
    even_surface,
    finer_surface,
    interpolated,
    outward_motion,
)
from objectfolder.acoustics.triangles import Triangles
from objectfolder.audio.click import AIR_DENSITY, SOUND_SPEED, Recoil
from objectfolder.mesh.topology import face_areas

EDGES_PER_WAVE = 2.0  #: of sound; with fewer, a surface radiates as plane waves do
_FINER = 0.5  # of a triangle's edge, on which modes' motions are read from the exact surface
_BEYOND = 4  # orders of harmonics beyond the wavenumber times the radius
_ALIKE = 0.04  # difference of wavenumbers, times the radius, within which modes share a matrix


@dataclass(frozen=True, kw_only=True)
class RadiationConfig:
    """Section ``radiation`` of ``params.yaml``."""

    triangles: Annotated[int, Ge(100)]  #: of the surface on which the sound is solved
    kilobytes: Annotated[int, Ge(1)]  #: that the Object File may grow by


def radiate(
    surface: tuple[np.ndarray, np.ndarray],
    points: np.ndarray,
    shapes: np.ndarray,
    frequencies: np.ndarray,
    triangles: int,
) -> FarField:
    """Compute the far field of each mode.

    Parameters
    ----------
    surface : (V, 3) and (F, 3) arrays
        Closed, metres, object frame.
    points : (P, 3) array
        Near the surface, metres.
    shapes : (P, 3, M) array
        Mass-normalised mode shapes at the points, kg^-1/2.
    frequencies : (M,) array
        Angular, rad/s.
    triangles : int
        See `even_surface`.

    Returns
    -------
    FarField
        Per unit of modal acceleration: pressure times distance, Pa m / (m kg^1/2 / s^2).
    """
    vertices, faces = even_surface(*surface, triangles)
    boundary = Boundary(vertices, faces)
    fine, parts = finer_surface(*surface, _FINER * boundary.mean_edge)
    parts = parts[face_areas(fine, parts) > 0]
    motion = interpolated(points, shapes.reshape(len(points), -1), fine).reshape(len(fine), 3, -1)
    source = Triangles.of(fine, parts)
    flow = outward_motion(fine, parts, motion) * source.area[:, None]
    motion = carried(source, flow, boundary.triangles) / boundary.triangles.area[:, None]
    radius = float(np.linalg.norm(surface[0], axis=1).max(initial=0))
    return of_motion(boundary, motion, frequencies, radius)


def of_motion(boundary: Boundary, motion: np.ndarray, frequencies: np.ndarray, radius: float) -> FarField:
    """Compute the far field of motions (N, M) of a boundary's triangles in a ball of some radius.

    Notes
    -----
    Waves shorter than two edges are not solved for: the pressure is then that of a plane wave, the specific
    impedance of air times the velocity. Fields with more detail than `MAX_ORDER` keep their power.
    """
    slopes, k = -AIR_DENSITY * motion, np.asarray(frequencies) / SOUND_SPEED
    orders = np.minimum(np.ceil(k * radius).astype(int) + _BEYOND, MAX_ORDER)
    radiator = Radiator(boundary.triangles, int(orders.max(initial=0)))
    coefficients = np.zeros((len(k), (radiator.order + 1) ** 2), np.complex128)
    area, of_degree = boundary.triangles.area, degrees(radiator.order)
    for modes in _alike(k, _ALIKE / radius):
        wavenumber = k[modes].mean()
        if wavenumber * boundary.mean_edge > 2 * np.pi / EDGES_PER_WAVE:
            pressure = -1j * slopes[:, modes] / wavenumber
        else:
            pressure = boundary.pressure(wavenumber, slopes[:, modes])
        found = radiator.coefficients(wavenumber, pressure, slopes[:, modes])
        found[of_degree > orders[modes, None]] = 0
        power = -area @ (pressure * slopes[:, modes]).imag / wavenumber
        kept = (abs(found) ** 2).sum(1)
        capped = (orders[modes] == MAX_ORDER) & (kept > 0)
        coefficients[modes] = found * np.where(capped, np.sqrt(power.clip(0) / kept), 1)[:, None]
    return FarField(orders, coefficients, radius)


def stored_radiation(
    field: FarField, surface: tuple[np.ndarray, np.ndarray], scale: float, limit: int
) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Return tensors and header of what an Object File stores of an object's radiation.

    Parameters
    ----------
    field : FarField
    surface : (V, 3) and (F, 3) arrays
        Metres.
    scale : float
        Longest side, metres.
    limit : int
        Bytes.
    """
    recoil = Recoil.of(surface[0], 1.0)
    header = {
        "kind": "spherical_harmonics",
        "radius": field.radius / scale,
        "recoil": {
            "centre": (recoil.centre / scale).tolist(),
            "axes": recoil.axes.tolist(),
            "radii": (recoil.radii / scale).tolist(),
        },
    }
    return pack_far_field(field, limit), header


def _alike(k: np.ndarray, span: float) -> list[np.ndarray]:
    """Group numbers that differ by at most a span; arrays of indices."""
    order = np.argsort(k, kind="stable")
    groups: list[list[int]] = []
    for index in order:
        if not groups or k[index] - k[groups[-1][0]] > span:
            groups.append([])
        groups[-1].append(int(index))
    return [np.array(group) for group in groups]
