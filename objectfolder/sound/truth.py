"""Ground-truth modes of an object: solved, or those of an earlier solve for another material or size."""

import hashlib
import json
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import asdict, fields
from typing import Any

import numpy as np

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.materials import Material
from objectfolder.mesh.topology import Mesh
from objectfolder.sound.fem.elasticity import Solid
from objectfolder.sound.fem.modal import (
    ModalData,
    Request,
    gather_modes,
    is_heard,
    refined_analysis,
    solved_band,
)
from objectfolder.sound.fem.settings import FineGrids, ModalConfig
from objectfolder.sound.fem.similarity import similarity
from objectfolder.sound.fem.tetrahedra import Tetrahedra


def compute_modes(
    solid: Solid,
    surface: Mesh,
    points: np.ndarray,
    request: Request,
    fine: FineGrids,
    problem: str,
    earlier: dict[str, np.ndarray] | None,
    name: str,
) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Compute modes at points (P, 3), unit frame; the arrays of ``modes.npz`` about them, and ``modal.json``.

    The solid is on the first grid; its surface is (V, 3), unit frame, and (F, 3). Modes of an ``earlier``
    ``modes.npz`` are rescaled if they serve; ``problem`` is the present `problem_digest`.
    """
    data, reused = None, False
    if earlier is not None:
        with suppress(ObjectFolderError):  # not a readable one
            data = repeated(earlier, problem, request)
            reused = data is None and (data := rescaled(earlier, problem, request)) is not None
    if data is None:
        data = refined_analysis(solid, surface, fine, points, request, name)
    record = {"problem": problem, "request": asdict(request), "report": data.report}
    arrays = data.arrays() | {
        "truncated": np.asarray(data.report["truncated"]),
        "band_hz": np.asarray(solved_band(data, request)),
        "solution": np.asarray(json.dumps(record, sort_keys=True)),
    }
    return arrays, data.report | {"reused": reused}


def problem_digest(
    files: Iterable[str], code: str, points: np.ndarray, poisson_ratio: float, config: ModalConfig
) -> str:
    """Return the digest of everything that modes depend on beyond scaling.

    Those of the solid and its surface, and of the code of a solve, are given; shapes are at points (P, 3).
    """
    place = hashlib.sha256(np.ascontiguousarray(points).tobytes()).hexdigest()
    options = {"fine": asdict(config.fine), "surface_points": config.surface_points}
    names = [field.name for field in fields(Material)]
    text = json.dumps([list(files), code, place, poisson_ratio, options, names], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def repeated(solved: dict[str, np.ndarray], problem: str, wanted: Request) -> ModalData | None:
    """Return the modes of the same request on tetrahedra, whose mesh would be another each time.

    None otherwise: a new solve gives the same bytes.
    """
    record = json.loads(str(solved["solution"]))
    if record["problem"] != problem or record["report"]["element"] != Tetrahedra.name:
        return None
    if Request.from_dict(record["request"]) != wanted:
        return None
    names = [field.name for field in fields(ModalData) if field.name != "report"]
    return ModalData(**{name: solved[name] for name in names}, report=record["report"])


def rescaled(solved: dict[str, np.ndarray], problem: str, wanted: Request) -> ModalData | None:
    """Rescale the modes of an earlier solve (``modes.npz``) if they cover the request; exact up to rounding.

    Returns None if a new solve is needed: for another solid or solver, or if the earlier solve dropped or did
    not seek some of the modes. Also for an identical request, so that rerunning the stage gives the same
    bytes. Report entries named ``*_hz`` scale like frequencies.
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
    kept = np.flatnonzero(below)[: wanted.max_modes]
    kept = kept[is_heard(eigenvalues[kept], wanted.material)]
    count = int(below.sum())
    estimates = (record["report"]["discretisation_error"] or [])[: min(count, wanted.max_modes)]
    report = {
        name: (np.array(value) * factor**0.5).tolist() if name.endswith("_hz") else value
        for name, value in record["report"].items()
    }
    report |= {
        "mass_kg": report["mass_kg"] / shape_factor**2,
        "count_below_max_frequency": count if complete else None,  # above the earlier limit, unknown
        "truncated": count > wanted.max_modes or not complete,
        "discretisation_error": estimates or None,
        "frequency_uncertainty": max(estimates, default=None),
        "residual_max": float(solved["residuals"][kept].max(initial=0.0)),
    }
    shapes = solved["shapes"][:, :, kept] * shape_factor
    return gather_modes(eigenvalues[kept], shapes, solved["residuals"][kept], wanted, report)
