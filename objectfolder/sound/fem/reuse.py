"""Reuse of an earlier solve for another stiffness, density, damping or size of the same solid."""

import dataclasses
import hashlib
import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from objectfolder.base.io import file_digest
from objectfolder.base.materials import Material
from objectfolder.sound.fem.certainty import solver_checks
from objectfolder.sound.fem.modal import MIN_FREQUENCY, ModalData
from objectfolder.sound.fem.similarity import similarity


@dataclass(frozen=True)
class Request:
    """Request for a modal analysis of a given solid."""

    material: Material
    scale: float  #: longest side, metres
    max_frequency: float  #: Hz
    max_modes: int

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> "Request":
        """Inverse of `dataclasses.asdict`."""
        return cls(**{**values, "material": Material(**values["material"])})


def problem_digest(
    files: Iterable[Path], code: str, points: np.ndarray, poisson_ratio: float, options: dict[str, Any]
) -> str:
    """Return the digest of everything that modes depend on beyond scaling.

    Parameters
    ----------
    files : iterable of Path
        The solid, its surface; those that exist.
    code : str
        Digest of the code of the solve.
    points : (P, 3) array
        Points at which the mode shapes are evaluated.
    poisson_ratio : float
    options : dict
        Options of the elements, as JSON values.
    """
    read = [file_digest(path) for path in files if path.is_file()]
    place = hashlib.sha256(np.ascontiguousarray(points).tobytes()).hexdigest()
    fields = [field.name for field in dataclasses.fields(Material)]
    text = json.dumps([read, code, place, poisson_ratio, options, fields], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def solution_record(problem: str, request: Request, data: ModalData) -> str:
    """Return the record of a solve that `rescaled` needs beside the arrays, as JSON."""
    return json.dumps(
        {"problem": problem, "request": dataclasses.asdict(request), "report": data.report}, sort_keys=True
    )


def rescaled(solved: dict[str, np.ndarray], problem: str, wanted: Request) -> ModalData | None:
    """Rescale the modes of an earlier solve if they cover the request; exact up to rounding.

    Parameters
    ----------
    solved : dict of arrays
        ``modes.npz`` of the earlier solve, with its ``solution`` and ``band_hz``.
    problem : str
        Digest of the present problem; see `problem_digest`.
    wanted : Request

    Returns
    -------
    ModalData or None
        None if a new solve is needed: for another solid or solver, or if the earlier solve dropped or did
        not seek some of the modes. Also None for an identical request, so that rerunning the stage gives
        the same bytes.

    Notes
    -----
    Report entries named ``*_hz`` scale like frequencies.
    """
    record = json.loads(str(solved["solution"]))
    if record["problem"] != problem:  # compared first: another version's request may have other fields
        return None
    old = Request.from_dict(record["request"])
    if old == wanted:
        return None
    low, high = solved["band_hz"]
    factor, shape_factor = similarity((old.material, old.scale), (wanted.material, wanted.scale))
    limit = (2 * np.pi * wanted.max_frequency) ** 2
    eigenvalues = solved["eigenvalues"] * factor
    below = eigenvalues < limit
    # Tolerates rounding where the band ends at the requested frequency.
    complete = (2 * np.pi * high) ** 2 * factor >= limit * (1 - 1e-9)
    if low > 0 or not (complete or below.sum() >= wanted.max_modes):
        return None
    damping = wanted.material.damping(eigenvalues)
    rings = (eigenvalues > damping**2) & (eigenvalues > (2 * np.pi * MIN_FREQUENCY) ** 2)
    kept = np.flatnonzero(below)[: wanted.max_modes]
    kept = kept[rings[kept]]
    natural = np.sqrt(eigenvalues[kept]) / (2 * np.pi)
    count = int(below.sum())
    estimates = (record["report"]["discretisation_error"] or [])[: min(count, wanted.max_modes)]
    report = (
        {
            name: (np.array(value) * factor**0.5).tolist() if name.endswith("_hz") else value
            for name, value in record["report"].items()
        }
        | {
            "material": wanted.material.name,
            "material_properties": wanted.material.properties(),
            "scale_m": wanted.scale,
            "mass_kg": record["report"]["mass_kg"] / shape_factor**2,
            "modes": len(kept),
            "modes_below_8_kHz": int((natural < 8000).sum()),
            "count_below_max_frequency": count if complete else None,  # above the earlier limit, unknown
            "truncated": count > wanted.max_modes or not complete,
            "max_frequency_hz": wanted.max_frequency,
            "discretisation_error": estimates or None,
            "frequency_uncertainty": max(estimates, default=None),
            "lowest_hz": natural[:8].round(2).tolist(),
            "residual_max": float(solved["residuals"][kept].max(initial=0.0)),
        }
    )
    return ModalData(
        eigenvalues=eigenvalues[kept],
        damping=damping[kept],
        damped_frequency=np.sqrt(eigenvalues[kept] - damping[kept] ** 2),
        shapes=(solved["shapes"][:, :, kept] * shape_factor).astype(np.float32),
        residuals=solved["residuals"][kept],
        report=report | solver_checks(report),
    )
