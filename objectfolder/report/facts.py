"""What a report says of one object: from its Object File, and from its build if that is there."""

import base64
import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from objectfolder.base.arrays import read_npz
from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.io import file_digest, read_json
from objectfolder.base.metrics import psnr
from objectfolder.base.seeding import numpy_generator
from objectfolder.engine.records import recall_costs
from objectfolder.objectfile.file import ObjectFile
from objectfolder.report.certificate import build_checks, file_checks
from objectfolder.report.comparison import SHOWN_RATE, join_images, join_spectrograms
from objectfolder.report.pictures import picture_uri, playing_rate, sound_uri
from objectfolder.sound.evaluation import UnitStrikes, compare_sounds
from objectfolder.sound.fem.certainty import uncertainty_warning
from objectfolder.sound.query import uncertainty_note
from objectfolder.stored.header import PARTS
from objectfolder.vision.evaluation import choose_views, compare_views
from objectfolder.workspace.layout import Build
from objectfolder.workspace.stages import OBJECT_STAGES

CAMERA = (1.9, -1.2, 1.1)
CAMERAS = np.array([CAMERA, (-1.6, -1.6, 1.2), (0.6, 2.0, 1.5)])
THUMBNAIL = 128  # pixels
VIEW_SIZE = 320
VIEWS, STRIKES, TOUCHES = 3, 2, 6
DEPTH = 0.001  # metres, of touches without a truth
#: Scores that a report compares between objects: path in the metrics, title, unit, whether more is better.
#: The page shows a share as per cent, and bytes as kB.
SCORES = (
    ("vision.psnr", "views", "dB", True),
    ("vision.psnr_lit_foreground", "views, lit object", "dB", True),
    ("audio.psnr", "sound", "dB", True),
    ("audio.gain_error", "gain error", "share", False),
    ("touch.psnr", "touch", "dB", True),
    ("touch.force_error", "force error", "share", False),
    ("file_bytes", "file size", "bytes", False),
)


@dataclass(frozen=True)
class ObjectReport:
    """Report of one object, as JSON."""

    row: dict[str, Any]  #: of the overview
    detail: dict[str, Any]  #: of the object's own page


def missing_object(key: str, entry: dict[str, Any], error: Exception | None = None) -> dict[str, Any]:
    """Return the row of an object that is not built, or with an error cannot be reported."""
    return {
        **{"key": key, "material": str(entry.get("material", "")), "size": entry.get("scale")},
        "missing": True,
        "failed": [] if error is None else ["Object can be reported"],
        "warnings": [f"not built: run `objectfolder build {key}`" if error is None else str(error)],
        "scores": {},
    }


def read_key(path: Path) -> str | None:
    """Return the key in an Object File; None if it cannot be read."""
    try:
        return ObjectFile.load(path).key
    except ObjectFolderError:
        return None


def object_report(path: Path, costs: bool = True) -> ObjectReport:
    """Report on an Object File, and on what its build cost if asked.

    If it is ``build/KEY/ObjectFile.safetensors`` of a workspace, truth and scores are read from there.
    """
    file = ObjectFile.load(path)
    build = _build_of(file, path)
    paths = (build.normalize, build.modal, build.metrics) if build else ()
    normalize, modal, metrics = [read_json(p) if p.is_file() else None for p in paths] or [None] * 3
    warnings = list((normalize or {}).get("warnings", []))
    if metrics and metrics.get("file_sha256") != file_digest(path):
        metrics = None
        left_out = "its scores and truth are of another Object File and left out"
        warnings.append(f"{left_out}: run `objectfolder build {file.key}`")
    truth = build if metrics else None
    note = uncertainty_warning(modal, file.key) if modal else uncertainty_note(file.header.get("audio", {}))
    if note:
        warnings.append(note)
    frequencies = file.frequencies if "audio" in file.header else np.zeros(0)
    if file.header.get("audio", {}).get("truncated"):
        warnings.append(f"only the lowest {len(frequencies)} modes are stored")
    checks = [asdict(check) for check in (*file_checks(file), *build_checks(normalize, modal, metrics))]
    row = {
        **{"key": file.key, "material": file.material, "size": file.scale, "modes": len(frequencies)},
        "lowest": round(float(frequencies.min()), 1) if len(frequencies) else None,
        "bytes": path.stat().st_size,
        "failed": [check["name"] for check in checks if not check["passed"]],
        "warnings": warnings,
        "scores": _scores(metrics or {"file_bytes": path.stat().st_size}),
    }
    if _seen(file):
        row["thumbnail"] = picture_uri(file.view(CAMERA, resolution=THUMBNAIL, lights="studio")[0])
    detail = {
        "key": file.key,
        "checks": checks,
        "modes": _modes(file, modal),
        "views": _views(file, truth, metrics),
        "sounds": _sounds(file, truth),
        "touches": _touches(file, truth),
        "provenance": _provenance(file, path),
        "costs": _costs(build) if costs else [],
        "file": base64.b64encode(path.read_bytes()).decode(),
    }
    return ObjectReport(row, detail)


def _seen(file: ObjectFile) -> bool:
    """Whether the file can be looked at: nets of kind ``surface`` shade its geometry."""
    vision = file.header.get("vision")
    return vision is not None and ("geometry" in file.header or vision["kind"] != "surface")


def _build_of(file: ObjectFile, path: Path) -> Build | None:
    """Return the build that wrote a file, if it lies in one."""
    parents = path.absolute().parents  # with cache.type symlink, the file itself lies in the cache
    build = Build(file.key, parents[min(2, len(parents) - 1)])
    return build if build.object_file.resolve() == path.resolve() else None


def _scores(metrics: dict[str, Any]) -> dict[str, float]:
    found = {}
    for name, *_ in SCORES:
        value: Any = metrics
        for part in name.split("."):
            value = value.get(part, {}) if isinstance(value, dict) else {}
        if isinstance(value, int | float) and math.isfinite(value):
            found[name] = _rounded(value)
    return found


def _modes(file: ObjectFile, modal: dict[str, Any] | None) -> list[list[float | None]]:
    """Return frequency, Hz, time to decay by 60 dB, s, quality factor and estimated error of each mode.

    None stands for what is not known, and for the time and quality of a mode that does not decay.
    """
    if "audio" not in file.header or not file.has_modes:
        return []
    damping = file.tuning().damping.double().numpy()
    errors = (modal or {}).get("discretisation_error") or []
    return [
        [
            round(float(frequency), 1),
            _rounded(math.log(1000) / rate) if rate else None,
            _rounded(math.pi * frequency / rate) if rate else None,
            _rounded(errors[n]) if n < len(errors) else None,
        ]
        for n, (frequency, rate) in enumerate(zip(file.frequencies, damping))
    ]


def _views(file: ObjectFile, build: Build | None, metrics: dict[str, Any] | None) -> list[dict[str, Any]]:
    """Return views in studio light, then held-out ones beside their truth."""
    if not _seen(file):
        return []
    images = file.view(CAMERAS, resolution=VIEW_SIZE, lights="studio")
    shown = [{"title": "studio light", "source": picture_uri(image)} for image in images]
    if build is None or metrics is None or not build.views("test").is_file():
        return shown
    data = read_npz(build.views("test"), "rgba", "camera_to_world", "light", "focal", "center")
    titles = choose_views(metrics["vision"], data["rgba"], VIEWS)
    compared = zip(*compare_views(file, data, list(titles)))
    named = (f"{title}, one point light" for title in titles.values())
    return shown + [_compared(title, *each) for title, each in zip(named, compared)]


def _compared(title: str, truth: np.ndarray, answer: np.ndarray, score: float) -> dict[str, Any]:
    """Return images beside each other, with the PSNR of the answer."""
    return {"title": title, "score": _rounded(score), "source": picture_uri(join_images(truth, answer))}


def _sounds(file: ObjectFile, build: Build | None) -> list[dict[str, Any]]:
    if "audio" not in file.header or "geometry" not in file.header:
        return []
    rng, rate = numpy_generator(0, file.key, "report"), playing_rate(file)
    modes = None
    if build is not None and build.modes.is_file():
        modes = read_npz(build.modes, "points", "split", "shapes", "damped_frequency", "damping")
        modes = modes if _holds(file, modes["damped_frequency"]) else None
    if modes is not None and (modes["split"] == 2).any():
        strikes = UnitStrikes.random(np.flatnonzero(modes["split"] == 2), STRIKES, rng)
        truths, answers = compare_sounds(file, modes, strikes, rate)
        titles = strikes.describe(modes["points"] * file.scale)
    else:
        points = file.sample_surface(STRIKES, seed=0)
        truths, answers = None, file.impact(points, rng.normal(size=(STRIKES, 3)), rate)
        titles = [f"at ({', '.join(f'{x:.1f}' for x in point * 1000)}) mm" for point in points]
    sounds = []
    for n, (title, answer) in enumerate(zip(titles, answers)):
        truth = None if truths is None else truths[n]
        peak = float(np.abs(answer if truth is None else truth).max())
        image, seconds = join_spectrograms(truth, answer, rate)
        sounds.append(
            {
                "title": title.replace("\n", " "),
                "axes": f"0 to {min(rate, SHOWN_RATE) / 2000:g} kHz upwards, 0 to {seconds:g} s to the right",
                "truth": None if truth is None else sound_uri(truth, peak, rate),
                "answer": sound_uri(answer, peak, rate),
                "source": picture_uri(image),
            }
        )
    return sounds


def _holds(file: ObjectFile, damped: np.ndarray) -> bool:
    """Whether a file stores these damped frequencies, 1/s, or none: the build may have others by now."""
    if not file.has_modes:
        return True
    stored = file.tuning().damped_frequency.double().numpy()
    return stored.shape == damped.shape and bool(np.allclose(stored, damped, rtol=1e-3))


def _touches(file: ObjectFile, build: Build | None) -> list[dict[str, Any]]:
    if "touch" not in file.header or "geometry" not in file.header:
        return []
    if build is None or not build.touch("test").is_file():
        return _touches_alone(file)
    data = read_npz(build.touch("test"), "images", "points", "depths", "angles", "obstructed")
    rows = _free_first(data["obstructed"], TOUCHES)
    answers = file.touch(data["points"][rows], data["depths"][rows], data["angles"][rows]) / 255.0
    truths = data["images"][rows] / 255.0
    if truths.shape != answers.shape:  # of another sensor, since the file was written
        return _touches_alone(file)
    titles = map(_contact, data["depths"][rows], data["obstructed"][rows])
    scores = np.asarray(psnr(np.square(answers - truths).mean((1, 2, 3))))
    return [_compared(*each) for each in zip(titles, truths, answers, scores)]


def _touches_alone(file: ObjectFile) -> list[dict[str, Any]]:
    """Return touches without a truth; none of a net that knows one press alone."""
    if file.fixed_contact is not None:
        return []
    depth = float(np.clip(DEPTH, *file.press_range()))
    pressed = file.press(file.sample_surface(3 * TOUCHES, seed=0), depth)
    return [
        {"title": _contact(depth, pressed.obstructed[row]), "source": picture_uri(pressed.images[row])}
        for row in _free_first(pressed.obstructed, TOUCHES)
    ]


def _free_first(obstructed: np.ndarray, count: int) -> np.ndarray:
    """Choose contacts at equal steps of those that nothing blocks; others only where these are too few."""
    blocked = obstructed > 0
    free = np.flatnonzero(~blocked)
    steps = np.linspace(0, len(free) - 1, min(count, len(free))).round().astype(int)
    return np.concatenate([free[steps], np.flatnonzero(blocked)[: count - len(steps)]])


def _contact(depth: float, obstructed: float) -> str:
    """Name a contact by its depth."""
    return f"{depth * 1e3:.2g} mm deep{', obstructed' if obstructed else ''}"


def _provenance(file: ObjectFile, path: Path) -> dict[str, str]:
    header = file.header
    found = {"Object File": file_digest(path), "format": header["format"]}
    found |= {f"net of {part}": header[part]["kind"] for part in PARTS if part in header}
    return found | {name: str(digest) for name, digest in header.get("provenance", {}).items()}


def _costs(build: Build | None) -> list[list[Any]]:
    """Return stage, processor and wall seconds, and peak MB of the recorded runs, in the order of a build."""
    costs = recall_costs(build.root, build.key) if build else {}
    return [
        [stage, _rounded(cost.cpu_seconds), _rounded(cost.seconds), _rounded(cost.peak_mb)]
        for stage in OBJECT_STAGES
        if (cost := costs.get(stage))
    ]


def _rounded(value: Any) -> float:
    """Return a number with four significant digits."""
    return float(f"{float(value):.4g}")
