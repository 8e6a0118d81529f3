"""Modal analysis of a solid: modes at points of its surface."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from objectfolder.base.materials import Material
from objectfolder.mesh.raycast import wall_thickness
from objectfolder.mesh.sampling import sample_surface
from objectfolder.mesh.topology import Mesh
from objectfolder.sound.fem.accuracy import ESTIMATED_MODES, Discretisation, resolved_frequency
from objectfolder.sound.fem.adaptive import fill_unsure, refine_grid
from objectfolder.sound.fem.certainty import solver_checks
from objectfolder.sound.fem.elasticity import Solid
from objectfolder.sound.fem.settings import FineGrids

MAX_VERTICES = 20_000  #: of a surface at which shapes are stored; furniture has hundreds of thousands
MIN_FREQUENCY = 20.0  # Hz, the lower end of hearing (supplementary C)


@dataclass(frozen=True)
class Request:
    """What is asked of a modal analysis of a given solid."""

    material: Material
    scale: float  #: longest side, metres
    max_frequency: float  #: Hz
    max_modes: int

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> "Request":
        """Inverse of `dataclasses.asdict`."""
        return cls(**{**values, "material": Material(**values["material"])})


@dataclass(frozen=True)
class ModalData:
    """Modes as stored in ``modes.npz``; SI units."""

    eigenvalues: np.ndarray  #: (M,) rad^2/s^2
    damping: np.ndarray  #: (M,) decay rates, 1/s
    damped_frequency: np.ndarray  #: (M,) angular, rad/s
    shapes: np.ndarray  #: (P, 3, M) float32 mode shapes at the points, kg^-1/2
    residuals: np.ndarray  #: (M,)
    report: dict[str, Any]  #: content of ``modal.json``

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays without the report."""
        return {name: value for name, value in vars(self).items() if name != "report"}


def modal_analysis(
    cells: Solid, points: np.ndarray, request: Request, name: str = "object", wall: float = np.inf
) -> ModalData:
    """Compute the modes of a solid and evaluate them at points (P, 3), unit frame.

    A mode decays with rate c (`Material.damping`) and rings at sqrt(lambda - c^2). Overdamped and inaudible
    modes are dropped. The thickness of the wall, unit frame, limits the highest resolved frequency.
    """
    return _modes_at(Discretisation(cells, request.material, request.scale), points, request, name, wall)


def _modes_at(
    candidate: Discretisation, points: np.ndarray, request: Request, name: str, wall: float
) -> ModalData:
    cells, material, scale = candidate.solid, candidate.material, candidate.scale
    fem = candidate.vibration.fem
    modes = candidate.vibration.modes_below(request.max_frequency, request.max_modes, name)
    rings = is_heard(modes.eigenvalues, material)
    eigenvalues = modes.eigenvalues[rings]
    nodal = modes.shapes[:, rings].reshape(len(fem.nodes), -1)
    shapes = cells.interpolate(nodal, points).reshape(len(points), 3, -1)
    errors = candidate.errors(np.sqrt(modes.eigenvalues[:ESTIMATED_MODES]) / (2 * np.pi))
    report = {
        "element": cells.name,
        "resolution": cells.resolution,
        "elements": cells.elements,
        "degrees_of_freedom": int(fem.stiffness.shape[0]),
        "mass_kg": float(cells.volume * scale**3 * material.density),
        "volume_error": cells.volume_error,  # before the correction of mass and stiffness
        "dropped_volume_share": cells.dropped_volume,
        "count_below_max_frequency": modes.count_below,
        "truncated": modes.truncated,
        "rigid_hz": modes.rigid_frequencies.round(4).tolist(),
        "residual_max": float(modes.residuals.max(initial=0.0)),
        "discretisation_error": errors,
        "frequency_uncertainty": max(errors, default=0.0) if errors is not None else None,
        "highest_resolved_hz": resolved_frequency(cells, material, scale, wall),
    }
    return gather_modes(eigenvalues, shapes, modes.residuals[rings], request, report)


def is_heard(eigenvalues: np.ndarray, material: Material) -> np.ndarray:
    """Return which modes ring and are not below hearing, by their eigenvalues (M,), rad^2/s^2."""
    damped = eigenvalues <= material.damping(eigenvalues) ** 2
    return ~damped & (eigenvalues > (2 * np.pi * MIN_FREQUENCY) ** 2)


def gather_modes(
    eigenvalues: np.ndarray,
    shapes: np.ndarray,
    residuals: np.ndarray,
    request: Request,
    report: dict[str, Any],
) -> ModalData:
    """Return modes that are heard as they are stored; completes the report by what is said of them."""
    frequencies, damping = np.sqrt(eigenvalues) / (2 * np.pi), request.material.damping(eigenvalues)
    report = report | {
        "material": request.material.name,
        "material_properties": request.material.properties(),
        "scale_m": request.scale,
        "max_frequency_hz": request.max_frequency,
        "modes": len(eigenvalues),
        "modes_below_8_kHz": int((frequencies < 8000).sum()),
        "lowest_hz": frequencies[:8].round(2).tolist(),
    }
    return ModalData(
        *(eigenvalues, damping, np.sqrt(eigenvalues - damping**2)),
        *(shapes.astype(np.float32), residuals, report | solver_checks(report)),
    )


def refined_analysis(
    solid: Solid,
    surface: Mesh,
    fine: FineGrids,
    points: np.ndarray,
    request: Request,
    name: str = "object",
) -> ModalData:
    """Compute modes as `modal_analysis`, on the mesh that `refine_grid` and `fill_unsure` choose.

    The solid is on the first grid; its surface is (V, 3), unit frame, and (F, 3).
    """
    candidate = refine_grid(solid, surface, fine, request.material, request.scale, name)
    candidate = fill_unsure(candidate, surface, fine, name)
    return _modes_at(candidate, points, request, name, wall_thickness(*surface))


def shape_points(vertices: np.ndarray, faces: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """Choose the points at which shapes are stored: vertices, at most `MAX_VERTICES`, then random points.

    Returns (min(V, `MAX_VERTICES`) + count, 3): so many random points, uniform by area.
    """
    if len(vertices) > MAX_VERTICES:
        kept = vertices[np.sort(rng.choice(len(vertices), MAX_VERTICES, replace=False))]
    else:
        kept = vertices
    return np.concatenate([kept, sample_surface(vertices, faces, count, rng)])


def solved_band(data: ModalData, request: Request) -> list[float]:
    """Return the band of natural frequencies in Hz in which no mode of the object is missing.

    `objectfolder.sound.tuning` rescales the modes to other materials and sizes of the same shape; the
    rescaled band bounds the frequencies for which that is valid. The solve had an upper limit, Hz, and a
    greatest number of modes. Both ends are equal if the band is empty; the lower is 0 only if no mode was
    dropped.
    """
    top, material = request.max_frequency, request.material
    if data.report["truncated"]:
        top = float(np.sqrt(data.eigenvalues[-1])) / (2 * np.pi) if len(data.eigenvalues) else 0.0
    count = data.report["count_below_max_frequency"]
    if data.report["modes"] == (request.max_modes if count is None else min(count, request.max_modes)):
        return [0.0, top]
    if material.loss_factor:  # it rings, whatever its frequency
        return [MIN_FREQUENCY, max(MIN_FREQUENCY, top)]
    # Some modes were inaudible or overdamped: a mode of natural frequency w rings if alpha + beta w^2 < 2 w.
    root = math.sqrt(max(0.0, 1 - material.alpha * material.beta))
    dull = (1 + root) / material.beta if material.beta else math.inf
    low = max(MIN_FREQUENCY, material.alpha / (1 + root) / (2 * np.pi))
    return [low, max(low, min(top, dull / (2 * np.pi)))]
