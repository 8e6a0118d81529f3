"""Certificate of an object: physical checks, each with its figure and its limit."""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from objectfolder.objectfile.file import ObjectFile
from objectfolder.report.pictures import playing_rate
from objectfolder.sound.fem.certainty import MAX_RESIDUAL, MAX_UNWARNED_ERROR, rigid_limit

STRIKES = 8  # points at which sounds and touches are checked
VOLUME = 0.05  # difference between the volume of the surface and that of the solid, relative
DEVIATION = 2.0  # distance of the closed surface from the mesh, percent of the size
LINEAR = 1e-5  # relative error of a sum of two strikes
LOST_ENERGY = 0.05  # share of a sound's energy in modes that are not stored


@dataclass(frozen=True)
class PhysicalCheck:
    """One check."""

    name: str
    figure: str  #: what was found
    limit: str  #: what was expected
    passed: bool


def file_checks(file: ObjectFile) -> list[PhysicalCheck]:
    """Check what an Object File answers, without its mesh."""
    return [*_solid_checks(file), *_sound_checks(file), *_touch_checks(file)]


def build_checks(
    normalize: dict[str, Any] | None, modal: dict[str, Any] | None, metrics: dict[str, Any] | None
) -> list[PhysicalCheck]:
    """Check what the stages of a build wrote: ``normalize.json``, ``modal.json`` and ``metrics/KEY.json``."""
    checks = []
    if normalize:
        far = normalize["deviation_max_percent"]
        checks.append(_most("Closed surface near the mesh", far, DEVIATION, " % of the size"))
    if modal:
        checks.append(_most("Largest residual of the modes, relative", modal["residual_max"], MAX_RESIDUAL))
        rigid, limit = max(modal["rigid_hz"]), rigid_limit(modal)
        checks.append(_most("Highest frequency of a rigid motion, 0 in theory", rigid, limit, " Hz"))
    scores = metrics or {}
    for sense, name, score, baseline in (
        ("vision", "Looks better than an empty picture", "psnr", "baseline_white"),
        ("audio", "Sounds better than silence", "psnr", "baseline_silence"),
        ("touch", "Feels better than the mean image", "psnr", "baseline_mean_image"),
    ):
        found = scores.get(sense, {})
        if score in found and baseline in found:
            checks.append(_least(name, found[score], found[baseline], " dB"))
    sound = scores.get("audio", {})
    if "gain_error" in sound and "baseline_nearest" in sound:
        name = "Error of gains, below that of the nearest known point"
        checks.append(_most_share(name, sound["gain_error"], sound["baseline_nearest"]))
    if "lost_energy" in sound:
        checks.append(_most_share("Energy of a sound in modes left out", sound["lost_energy"], LOST_ENERGY))
    return checks


def _most(name: str, value: float, limit: float, unit: str = "") -> PhysicalCheck:
    return PhysicalCheck(name, f"{value:.3g}{unit}", f"at most {limit:.3g}{unit}", bool(value <= limit))


def _most_share(name: str, value: float, limit: float) -> PhysicalCheck:
    return _most(name, value * 100, limit * 100, " %")


def _least(name: str, value: float, limit: float, unit: str = "") -> PhysicalCheck:
    return PhysicalCheck(name, f"{value:.3g}{unit}", f"at least {limit:.3g}{unit}", bool(value >= limit))


def _solid_checks(file: ObjectFile) -> list[PhysicalCheck]:
    solid = file.header.get("solid")
    if solid is None or "geometry" not in file.header:
        return []
    # Not `objectfolder.mesh.topology`: igl comes with the extra build.
    volume = float(np.linalg.det(file.surface.vertices[file.surface.faces]).sum() / 6)
    xx, yy, zz, xy, xz, yz = solid["inertia"]
    least, middle, most = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    low, high = file.bounds / file.scale
    inside = np.minimum(np.array(solid["centre"]) - low, high - np.array(solid["centre"])).min()
    return [
        _most_share("Volumes of surface and solid differ by", abs(volume / solid["volume"] - 1), VOLUME),
        _least("Two smaller moments of inertia, over the largest", (least + middle) / most, 1.0),
        _least("Centre of mass, depth in the bounding box", float(inside) * file.scale * 1000, 0.0, " mm"),
    ]


def _sound_checks(file: ObjectFile) -> list[PhysicalCheck]:
    if not {"geometry", "audio"} <= file.header.keys() or not len(file.frequencies):
        return []
    checks = []
    audio = file.header["audio"]
    unknown = math.inf if audio.get("frequency_uncertainty_unknown") else None
    if (error := audio.get("frequency_uncertainty", unknown)) is not None:
        check = _most_share("Estimated error of frequencies", error, MAX_UNWARNED_ERROR)
        figure = "not known" if math.isinf(error) else check.figure
        figure += ", sound marked uncertain" if audio.get("uncertain") else ""
        checks.append(replace(check, figure=figure))
    points, rate = file.sample_surface(STRIKES, seed=0), playing_rate(file)
    rng = np.random.default_rng(0)
    first, second = rng.normal(size=(2, STRIKES, 3))
    a, b, both = (
        file.impact(points, f, rate, duration=0.25).astype(float) for f in (first, second, first + second)
    )
    if both.any():
        error = np.linalg.norm(a + b - both) / np.linalg.norm(both)
        checks.append(_most("Two strikes at once differ from their sum by", float(error), LINEAR))
    if file.has_modes:
        least, name = float(file.tuning().damping.min()), "Every mode decays: least rate"
        checks.append(PhysicalCheck(name, f"{least:.3g} 1/s", "above 0", least > 0))
    return checks


def _touch_checks(file: ObjectFile) -> list[PhysicalCheck]:
    if not {"geometry", "touch"} <= file.header.keys() or file.fixed_contact is not None:
        return []
    low, high = file.press_range()  # the net learned no others
    if low == high:
        return []
    points = np.repeat(file.sample_surface(STRIKES, seed=0), 3, axis=0)
    depths = np.tile(np.linspace(low, high, 3), STRIKES)
    touches = file.press(points, depths)
    # Where another part of the object meets the sensor first, depth says nothing of the contact.
    free = (touches.obstructed.reshape(STRIKES, 3) == 0).all(1)
    area, force = (values.reshape(STRIKES, 3)[free] for values in (touches.area, touches.force))
    if not free.any():
        return []
    checks = [_least("Deeper presses touch more", (np.diff(area, axis=1) >= 0).mean() * 100, 100, " %")]
    if np.isfinite(force).all() and force.any():
        grows = (np.diff(force, axis=1) > 0).mean() * 100
        checks.append(_least("Deeper presses push harder", float(grows), 100, " %"))
    return checks
