"""Join geometry and trained nets into the header and tensors of an Object File."""

from typing import Any

import numpy as np

from objectfolder.base.checks import check_mass
from objectfolder.mesh.featurecodec import Features, pack_features
from objectfolder.mesh.gridcodec import EFFORT, pack_grid
from objectfolder.stored.header import MODALITIES, RADIATION, checked_header, format_name

ESTIMATING = "hex20 cut cells"  #: element whose errors of frequencies are estimated if its grid allows it


def pack_object_file(
    key: str,
    modal: dict[str, Any],
    normalize: dict[str, Any],
    sdf: dict[str, np.ndarray],
    nets: dict[str, tuple[dict[str, np.ndarray], dict[str, Any]]],
    provenance: dict[str, str],
    radiation: tuple[dict[str, np.ndarray], dict[str, Any]] | None = None,
    mass: float | None = None,
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Return the header and the tensors of an Object File.

    ``modal`` is ``modal.json``: material and scale of the solid whose modes the audio net holds, and how
    accurate their frequencies are; ``normalize`` is ``normalize.json``: mass properties and the transform to
    the source mesh. ``sdf`` holds ``values`` int8, ``band``, and the arrays of `Features`, if the surface has
    any; ``nets`` per modality its tensors and header, as the training stages wrote them; ``provenance`` the
    SHA-256 of each input, by name; ``radiation`` what its stage wrote, which is left out with an audio net
    without modes; ``mass`` that of the real object, kg, if it was weighed. Raises ObjectFolderError if the
    header breaks the schema, or a body of this mass and volume is impossible.
    """
    named = modal["material"], modal["material_properties"]
    header, tensors = pack_shape(key, named, modal["scale_m"], normalize, sdf, provenance, mass)
    for modality in MODALITIES:
        net_tensors, net_header = nets[modality]
        tensors.update({f"{modality}.{name}": value for name, value in net_tensors.items()})
        header[modality] = net_header
    if radiation is not None and "damping" in nets["audio"][0]:  # a net of modes
        tensors.update({f"{RADIATION}.{name}": value for name, value in radiation[0].items()})
        header[RADIATION] = radiation[1]
    header["audio"] = header["audio"] | certainty(modal)
    return checked_header(header, key), tensors


def pack_shape(
    key: str,
    material: tuple[str, dict[str, Any]],
    scale: float,
    normalize: dict[str, Any],
    sdf: dict[str, np.ndarray],
    provenance: dict[str, str],
    mass: float | None = None,
    effort: int = EFFORT,
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Return the header and the tensors of an Object File without nets: shape, material and mass.

    ``material``: its name and properties; ``scale``: longest side, metres; ``effort``: as of `pack_grid`; the
    others are as of `pack_object_file`. Raises ObjectFolderError if a body of this mass and volume is
    impossible.
    """
    stream, predictor = pack_grid(sdf["values"], effort)
    tensors = {"geometry.distances": stream}
    geometry: dict[str, Any] = {
        "kind": "distance_grid",
        "resolution": len(sdf["values"]),
        "band": float(sdf["band"]),
        "predictor": predictor,
    }
    features = Features.from_arrays(sdf)
    if features is not None:
        tensors["geometry.features"] = pack_features(features)
        geometry |= features.counts
    header: dict[str, Any] = {
        "format": format_name(),
        "key": key,
        "material": material[0],
        "material_properties": material[1],
        "scale": scale,
        "source": {name: normalize[name] for name in ("source_centre", "source_size", "source_up")},
        "solid": normalize["solid"],
        "geometry": geometry,
        "provenance": provenance,
    }
    if mass is not None:
        check_mass(key, mass, normalize["solid"]["volume"] * scale**3)
        header["mass"] = mass
    return header, tensors


def certainty(modal: dict[str, Any]) -> dict[str, Any]:
    """Return what the header says of the error of frequencies, from ``modal.json``."""
    marked = {"uncertain": True} if modal.get("uncertain") else {}
    if modal.get("frequency_uncertainty") is not None:
        return {"frequency_uncertainty": modal["frequency_uncertainty"]} | marked
    if modal.get("element") == ESTIMATING and modal["modes"]:
        return {"frequency_uncertainty_unknown": True} | marked
    return {}
