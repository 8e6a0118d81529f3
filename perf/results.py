"""Assemble docs/results.md from metrics/*.json and build/perf/*.json: `python perf/results.py`.

Figures come from `objectfolder build` and from the other scripts here; this only lays them out.
"""

import json
import math
import platform
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

from query import FIGURES, MEDIAN_KB, shown
from robot_results import grasps_per_second, labels, robot_tables
from ruamel.yaml import YAML

from objectfolder.benchmarks.layout import Benchmarks
from objectfolder.benchmarks.params import splits_of
from objectfolder.benchmarks.scoring import tables
from objectfolder.io import atomic, read_json

ROOT = Path(__file__).parents[1]
VISION = (
    "psnr",
    "noise_floor",
    "psnr_pooled",
    "psnr_worst",
    "psnr_lit_foreground",
    "noise_floor_lit",
    "ssim",
    "baseline_white",
    "views",
)
AUDIO = (
    "psnr",
    "psnr_own_max",
    "baseline_silence",
    "baseline_noise",
    "gain_error",
    "gain_error_frobenius",
    "gain_error_worst",
    "worst_mode_hz",
    "frequency_error",
    "decay_time_error",
    "modes",
    "modes_heard",
)
NOISE = (
    "The true views are path-traced, and noisy: `noise_floor` and `noise_floor_lit` are the `psnr` and",
    "`psnr_lit_foreground` of a perfect answer, from two independent halves of each view.",
)
KNOWLEDGE = (
    "The default net `surface` is told more than the paper's `osf`. Both learn from the same views with",
    "their cameras and lights. `surface` also has the geometry: signed distances of the mesh, stored at",
    "192^3 or 256^3, give it silhouettes, depths and shadows that no view has to teach. It has the look",
    "of the mesh: base colour and shading normal at points of the surface, stored in a hash grid, not",
    "inferred from pictures. And it has the ground truth's shading model: a point light's falloff, shadow",
    "rays, the renderer's BSDF with the mesh's roughness and metallic; a query even computes the diffuse",
    "interreflection of the stored surface. From views it learns what else bounces, and corrects that.",
    "`osf` learns density, shading and shadows from pictures alone, and knows the cube that holds the",
    "object, the light's falloff and that the background is white. The scores say what the pipeline",
    "delivers, which owns the mesh; they do not say that one learns better from pictures than the other.",
)
TOUCH = (
    "psnr",
    "psnr_median",
    "psnr_unobstructed",
    "psnr_median_unobstructed",
    "psnr_contact",
    "force_error",
    "obstructed_fraction",
    "baseline_mean_image",
    "contacts",
)


COMMANDS = {"recognize": "recognition", "retrieve": "retrieval", "reconstruct": "reconstruction"}
BENCHMARKS = (
    "What is observed, the splits and what differs from the paper: [benchmarks.md](benchmarks.md). The",
    "paper's figures are of its 100 objects with ImageNet's weights; ours, where nothing else is said, of",
    "fewer objects with smaller inputs and random weights: they show what the tasks do, and do not repeat",
    "the paper's. Object Files of preset `quick` (with fewer test views and contacts, on which they do not",
    "depend), seed 0. The splits of a task ran side by side; little else ran.",
)


def table(metrics: dict[str, dict], modality: str, columns: tuple[str, ...]) -> list[str]:
    lines = [f"| object | {' | '.join(columns)} |", "|---" * (len(columns) + 1) + "|"]
    for key, values in metrics.items():
        cells = [values[modality].get(c) for c in columns]
        shown = [
            f"{v:.3f}" if isinstance(v, float) and abs(v) < 2 else f"{v:.2f}" if isinstance(v, float) else v
            for v in cells
        ]
        lines.append(f"| {key} | {' | '.join('-' if v is None else str(v) for v in shown)} |")
    return [f"\n## {modality.capitalize()}\n", *lines]


def preset(values: dict) -> str:
    for path in sorted((ROOT / "params").glob("*.yaml")):
        sections = YAML(typ="safe").load(path.read_text())
        if all(values.get(name) == content for name, content in sections.items()):
            return path.stem
    return "own"


def geometry(figures: dict) -> list[str]:
    """Table of what `perf/geometry.py` has measured."""
    lines = [
        "\n## Geometry\n",
        "Real meshes through normalize and voxelize: `python perf/geometry.py --objects DIR --json "
        "build/perf/geometry.json`, one fresh process with one thread per object, CPU seconds. "
        "Volume in % of the unit cube; deviation from the source in % of the longest side.",
        "",
        "| object | rung | bodies | volume % | mean dev. % | max dev. % | FEM volume error % | "
        "normalize s | voxelize s | peak MB |",
        "|---" * 10 + "|",
    ]
    for row in figures["objects"]:
        if "refused" in row:
            reason = row["refused"].partition(": ")[2]
            lines.append(f"| {row['object']} | refused: {reason} |" + " |" * 8)
            continue
        values = (
            row["rung"],
            row["components"],
            f"{row['volume_m3']:.3%}"[:-1],
            f"{row['deviation_mean']:.2g}",
            f"{row['deviation_max']:.2g}",
            f"{row['volume_error']:+.4%}"[:-1],
            *(f"{row[name]:.2f}" for name in ("normalize_s", "voxelize_s")),
            f"{row['peak_mb']:.0f}",
        )
        lines.append(f"| {row['object']} | {' | '.join(map(str, values))} |")
    peer = figures["distance_grid"]
    lines += [
        "",
        f"Distance grid at 64^3 of {peer['object']}: {peer['own_s']:.2f} s; libigl's distance and winding "
        f"number of every sample {peer['peer_s']:.2f} s, {peer['peer_s'] / peer['own_s']:.1f} times as long; "
        f"the answers are at most {peer['apart_voxels']:.3f} voxels apart.",
    ]
    return lines


def audio(figures: dict) -> list[str]:
    """Table of what `perf/audio.py` has measured."""
    lines = [
        "\n## AudioNet `gains`\n",
        "`python perf/audio.py --json build/perf/audio.json`: training and the error of the stored net at "
        "surface points that training has not seen; one fresh process with one thread per object, CPU s. "
        "Energy-weighted and Frobenius errors are relative; dB of complex spectrograms in the paper's "
        "convention, and how far above silence.",
        "",
        "| object | modes | steps | CPU s | KB | energy % | Frobenius % | worst mode | dB | above silence |",
        "|---" * 10 + "|",
    ]
    for row in (row for row in figures["objects"] if "failed" not in row):
        values = (
            row["object"],
            row["modes"],
            row["steps"],
            f"{row['seconds']:.0f}",
            f"{row['file_kb']:.0f}",
            f"{row['gain_error']:.2%}"[:-1],
            f"{row['gain_error_frobenius']:.2%}"[:-1],
            f"{row['worst_mode_error']:.1%} at {row['worst_mode_hz']:.0f} Hz",
            *(f"{row[name]:.1f}" if name in row else "-" for name in ("psnr", "above_silence")),
        )
        lines.append(f"| {' | '.join(map(str, values))} |")
    return lines


def modal(figures: dict) -> list[str]:
    """Tables of what `perf/modal.py` has measured."""
    lines = [
        "\n## Modal analysis and synthesis\n",
        "`python perf/modal.py --json build/perf/modal.json`: the stage `modal` and the synthesis of its "
        "sounds (two seconds at 48 kHz), one fresh process with one thread each, CPU s. The naive loop adds "
        "one damped sinusoid per mode and sound.",
        "",
        "| object | cells | dof | modes | CPU s | peak MB | ms per sound | naive loop, ms | times |",
        "|---" * 9 + "|",
    ]
    for row in (row for row in figures["objects"] if "failed" not in row):
        own, naive = row.get("synthesis_ms_per_sound"), row.get("naive_ms_per_sound")
        values = (
            row["object"],
            f"{row['resolution']}^3",
            f"{row['degrees_of_freedom']:,}",
            row["modes"],
            f"{row['seconds']:.1f}",
            f"{row['peak_mb']:.0f}",
            *((f"{own:.2f}", f"{naive:.0f}", f"{naive / own:.0f}") if own else ("-",) * 3),
        )
        lines.append(f"| {' | '.join(map(str, values))} |")
    lines += [
        "",
        "The solver call beside the peers' on the same matrices: DeepModal shifts to the middle of the band "
        "and grows the number of modes, NeuralSound shifts to zero, both with SuperLU's default ordering.",
        "",
        "| object | dof | modes | own s | DeepModal s | times | NeuralSound s | times |",
        "|---" * 8 + "|",
    ]
    for row in (row for row in figures["peers"] if "failed" not in row):
        peers = (
            (f"{row[f'{name}_s']:.1f}", f"{row[f'{name}_s'] / row['own_s']:.1f}")
            if f"{name}_s" in row
            else ("fails", "-")
            for name in ("deepmodal", "neuralsound")
        )
        shown = (f"{row['degrees_of_freedom']:,}", row["modes"], f"{row['own_s']:.1f}", *sum(peers, ()))
        lines.append(f"| {row['object']} | {' | '.join(map(str, shown))} |")
    return lines


def accuracy(rows: list[dict]) -> list[str]:
    """Table of what `perf/modal_accuracy.py` has measured."""
    lines = [
        "\n## Accuracy of the modal analysis\n",
        "`python perf/modal_accuracy.py --tetrahedra --objects DIR --json build/perf/modal_accuracy.json`: "
        "largest relative error, against analytic truths, converged series and quadratic tetrahedra; of real "
        "objects, the first 8 modes on the grid that the stage takes against 64^3. CPU s of one core.",
        "",
        "| what | value | target | |",
        "|---|---|---|---|",
    ]
    for row in rows:
        known = math.isfinite(row["target"])
        verdict = ("met" if row["value"] <= row["target"] else "**missed**") if known else ""
        figures = f"{row['value']:.3g} | {row['target'] if known else '-'}"
        notes = "; ".join(note for note in (verdict, row["detail"]) if note)
        lines.append(f"| {row['name']} | {figures} | {notes} |")
    return lines


def renderers(figures: dict) -> list[str]:
    """Table of what `perf/vision.py renderers` has measured."""
    lines = [
        "\n## Renderers\n",
        "`python perf/vision.py renderers --json build/perf/renderers.json`: the same views at 256 x 256 by "
        "each renderer, one fresh process with one thread each, CPU ms per image at 16 and 64 samples per "
        "pixel. PSNR and mean difference on white in sRGB against mitsuba's scalar variant at 64 samples, "
        "over the pixels that the object covers, and those of them that are lit. The llvm variant differs "
        "by noise alone, of both; cycles also by its BSDF, and raster by lacking "
        "shadows.",
        "",
        "| object | renderer | ms, 16 | ms, 64 | peak MB | foreground dB | lit dB | mean diff. | lit diff. |",
        "|---" * 9 + "|",
    ]
    for row in (row for row in figures["renderers"] if "failed" not in row):
        shown = [f"{row['ms_16']:.0f}", f"{row['ms_64']:.0f}", f"{row['peak_mb']:.0f}"]
        apart = (
            ("psnr_foreground", "psnr_lit_foreground"),
            ("difference_foreground", "difference_lit_foreground"),
        )
        shown += [f"{row[name]:.1f}" if name in row else "" for name in apart[0]]
        shown += [f"{row[name]:+.4f}" if name in row else "" for name in apart[1]]
        lines.append(f"| {row['object']} | {row['version']} | {' | '.join(shown)} |")
    return lines


def training(figures: dict) -> list[str]:
    """Table of what `perf/vision.py training` has measured."""
    lines = [
        "\n## VisionNet `surface` at preset standard\n",
        "`python perf/vision.py training --json build/perf/vision_training.json`: the stage "
        "`train_vision`, one fresh process with one thread per object, CPU s from its start, with imports, "
        "ray casting and validation. 40 dB are reached when the validation loss says so: it pools the "
        "pixels of all validation views but those at silhouettes and shadow edges. val. and stored: mean "
        "PSNR of whole validation views before and after storing (float32, then tables as int8 and the "
        "rest as float16). Then test views, which chose nothing: mean, worst view, and the lit foreground; "
        "noise and lit noise: what a perfect answer would score against these views, which are path-traced; "
        "white: what a white image scores.",
        "",
        "| object | views | CPU s to 40 dB | CPU s | peak MB | net KB | grid KB | val. | stored | test "
        "| worst | lit | noise | lit noise | white |",
        "|---" * 15 + "|",
    ]
    kinds = {
        "seconds_reached": ".1f",
        "seconds": ".1f",
        "peak_mb": ".0f",
        "net_kb": ".0f",
        "geometry_kb": ".0f",
        "psnr_val": ".2f",
        "psnr_val_stored": ".2f",
        "psnr": ".2f",
        "psnr_worst": ".1f",
        "psnr_lit_foreground": ".1f",
        "noise_floor": ".1f",
        "noise_floor_lit": ".1f",
        "baseline_white": ".1f",
    }
    for row in (row for row in figures["training"] if "failed" not in row):
        values = [format(row[name], kind) if name in row else "-" for name, kind in kinds.items()]
        lines.append(f"| {row['object']} | {row['train_views']} | {' | '.join(values)} |")
    return lines


def query(figures: dict) -> list[str]:
    """Table of what `perf/vision.py query` has measured."""
    lines = [
        "\n## Query of a view\n",
        "`python perf/vision.py query --json build/perf/vision_query.json`: CPU ms per view of 256 x 256 "
        "with one sample per pixel (`supersample=False`) and with more at edges (the default), mean of "
        "random cameras; one fresh process with one thread per object. Loading includes extracting the "
        "surface, once.",
        "",
        "| object | net | load ms | ms, 1 sample | ms, adaptive | peak MB |",
        "|---" * 6 + "|",
    ]
    rows = [row for row in figures["query"] if "failed" not in row]
    for row in rows:
        values = [
            f"{row[name]:.0f}" if name in row else "-" for name in ("load_ms", "ms_single", "ms_adaptive")
        ]
        lines.append(f"| {row['object']} | {row['net']} | {' | '.join(values)} | {row['peak_mb']:.0f} |")
    for row in (row for row in rows if "rays" in row):
        lines += [
            "",
            f"`osf` has the size of the paper's net and is untrained: {row['rays_timed']} rays through the "
            f"middle of a view are timed and extrapolated to its {row['rays']}. A trained one does not ask "
            "for the scattered fraction of samples that it finds empty, and is somewhat faster.",
        ]
    return lines


def queries(figures: dict) -> list[str]:
    """Table of what `perf/query.py` has measured."""
    titles = [title for title, *_ in FIGURES.values()]
    lines = [
        "\n## Queries\n",
        "`python perf/query.py FILE ... --mixed 10000 --json build/perf/query.json`: Object Files of preset "
        "`standard`; fresh processes with one thread, CPU time, medians. A view has 256 x 256 pixels, a "
        "sound two seconds at 16 kHz, a touch the soft gel of `digit`. The first touch counts from the start "
        "of Python, with all imports. The authors' figures are theirs (Gao et al. 2022, Table 1), on a GPU "
        "that they do not name.",
        "",
        f"| object | {' | '.join(titles)} |",
        "|---" * (len(titles) + 1) + "|",
    ]
    for row in figures["objects"]:
        lines.append(f"| {row['object']} | {' | '.join(shown(row[name]) for name in FIGURES)} |")
    for i, name in enumerate(("target, at most", "released 1.0, GPU", "released 2.0, GPU"), 1):
        known = (shown(figure[i]) for figure in FIGURES.values())
        lines.append(f"| {name} | {' | '.join(known)} |")
    middle = median(row["file_kb"] for row in figures["objects"])
    lines += ["", f"Median size: {middle:.0f} KB (target {MEDIAN_KB:.0f})."]
    lines += [
        f"{row['object']}: {row['mixed_queries']} mixed queries from four threads, of which "
        f"{row['differing']} have other bytes than when asked one after the other."
        for row in figures["objects"]
        if "mixed_queries" in row
    ]
    return lines


def released(figures: dict) -> list[str]:
    """Table of what `perf/released.py` has measured."""
    return [
        "\n## Queries of released files\n",
        "`python perf/released.py --json build/perf/released.json`: files of ObjectFolder 1.0 and 2.0 after "
        "`objectfolder import`; nets of the released size with random weights, one thread, CPU time.",
        "",
        "| query | CPU ms |",
        "|---|---|",
        *(f"| {name} | {shown(value)} |" for name, value in figures.items()),
    ]


def primary(figures: dict) -> list[str]:
    """Table of what `perf/vision.py primary` has measured."""
    lines = [
        "\n`python perf/vision.py primary --json build/perf/vision_primary.json`: what the ray through each "
        "pixel's centre meets, by the ray caster that queries use and by a sphere tracer on the same grid.",
        "",
        "| object | caster ms | its surface, once, ms | tracer ms | depth apart, voxels: median, 99 % "
        "| pixels that one meets |",
        "|---" * 6 + "|",
    ]
    return lines + [
        f"| {r['object']} | {r['ms_caster']:.1f} | {r['ms_extract']:.0f} | {r['ms_tracer']:.1f} | "
        f"{r['voxels_median']:.3f}, {r['voxels_99']:.2f} | {r['hits_apart']:.0f} |"
        for r in figures["primary"]
    ]


def measured(*parts: tuple[str, Callable[[Any], list[str]]]) -> list[str]:
    """Lay out a section: what `perf/NAME.py --json build/perf/NAME.json` has left, if all of it is there."""
    paths = [ROOT / "build" / "perf" / f"{name}.json" for name, _ in parts]
    if not all(path.is_file() for path in paths):
        return []
    return [line for path, (_, layout) in zip(paths, parts) for line in layout(json.loads(path.read_text()))]


def merged(old: str, new: str) -> str:
    """Replace the sections of a page that were measured anew; the others stay as they are."""
    head, *kept = old.split("\n## ")
    new_head, *fresh = new.split("\n## ")
    titles = [section.partition("\n")[0] for section in fresh]
    by_title = dict(zip(titles, fresh))
    sections = [by_title.pop(section.partition("\n")[0], section) for section in kept]
    return "\n## ".join(part.rstrip() + "\n" for part in [new_head or head, *sections, *by_title.values()])


def touch_accuracy(figures: dict) -> list[str]:
    """Table of what `perf/touch.py accuracy` has measured."""
    lines = [
        "\n## Touch beside TACTO's renderer\n",
        "`python perf/touch.py accuracy --json build/perf/touch_accuracy.json`: PSNR in dB of all pixels / "
        "of those in contact, against TACTO's renderer; its images by ray casting, and images from "
        "heightmaps of unobstructed contacts. TACTO shades with normals that it interpolates across edges: "
        "on meshes of few triangles (stool, table, the clamp's arms) a heightmap cannot know them.",
        "",
        "| object | contacts | ray casting | unobstructed | heightmap |",
        "|---" * 5 + "|",
    ]
    for row in (row for row in figures["accuracy"] if "tacto" in row):
        drawn, flat = (
            f"{row[name]:.1f} / {row[f'{name}_contact']:.1f}" if name in row else "-"
            for name in ("tacto", "heightmap")
        )
        values = (row["object"], row["contacts"], drawn, row["unobstructed"], flat)
        lines.append(f"| {' | '.join(map(str, values))} |")
    return lines


def touch_speed(figures: dict) -> list[str]:
    """Table of what `perf/touch.py speed` has measured."""
    columns = {
        "heightmap": "heightmap",
        "gel": "soft gel",
        "optics": "optics",
        "rigid_single": "rigid, one",
        "rigid_batch": "rigid, batch",
        "soft_single": "soft, one",
        "soft_batch": "soft, batch",
        "tacto": "TACTO's by rays",
        "reference": "TACTO's renderer",
    }
    lines = [
        "\n## Query of a touch\n",
        "`python perf/touch.py speed --json build/perf/touch_speed.json`: CPU ms per image, one fresh "
        "process with one thread per object.",
        "",
        f"| object | {' | '.join(columns.values())} |",
        "|---" * (len(columns) + 1) + "|",
    ]
    for row in (row for row in figures["speed"] if "failed" not in row):
        shown = [f"{row[name]:.1f}" if name in row else "-" for name in columns]
        lines.append(f"| {row['object']} | {' | '.join(shown)} |")
    return lines


def touch_query(figures: dict) -> list[str]:
    """Table of what `perf/touch.py query` has measured."""
    names = ("rigid_single", "rigid_batch", "soft_single", "soft_batch")
    lines = [
        "\n`python perf/touch.py query --json build/perf/touch_query.json`: CPU ms per touch of an Object "
        "File, one call each and all 40 in one; snapping and contact normals included. Targets: rigid 8 and "
        "4, soft 7.",
        "",
        "| object | rigid, one | rigid, batch | soft, one | soft, batch |",
        "|---" * 5 + "|",
    ]
    for row in (row for row in figures["query"] if "failed" not in row):
        lines.append(f"| {row['object']} | {' | '.join(f'{row[name]:.1f}' for name in names)} |")
    return lines


def touch_dataset(figures: dict) -> list[str]:
    """What `perf/touch.py dataset` has measured."""
    return ["\n`python perf/touch.py dataset --json build/perf/touch_dataset.json`, soft gel:"] + [
        f"{row['object']}, {row['contacts']} contacts: {row['render_s']:.1f} CPU s to render and "
        f"{row['write_s']:.1f} to write (target 30 in all), {row['peak_mb']:.0f} MB."
        for row in figures["dataset"]
        if "failed" not in row
    ]


def touch_net(figures: dict) -> list[str]:
    """Table of what `perf/touch.py net` has measured."""
    columns = ("soft_unobstructed", "soft_median", "soft_contact", "soft_all")
    tacto = ("tacto_unobstructed", "tacto_median", "tacto_all")
    lines = [
        "\n## TouchNet `geometric` at held-out contacts\n",
        "`python perf/touch.py net --objects DIR --resolution 192 256 --json build/perf/touch_net.json`: "
        "PSNR in dB at contacts that its one number, the depth offset, was not fitted to, by the grid that "
        "stores the geometry. Ground truth: the soft gel on the exact surface, and TACTO's images (rigid "
        "gel). Pooled and median over unobstructed contacts, their pixels in contact, and all contacts "
        "pooled.",
        "",
        "| object | grid | contacts | unobstructed | soft gel | median | contact | all | force error | TACTO "
        "| median | all |",
        "|---" * 12 + "|",
    ]
    for row in (row for row in figures["net"] if "failed" not in row):
        values = (
            row["object"],
            f"{row['resolution']}^3",
            row["contacts"],
            row["unobstructed"],
            *(f"{row[name]:.1f}" for name in columns),
            f"{row['force_error']:.1%}",
            *(f"{row[name]:.1f}" for name in tacto),
        )
        lines.append(f"| {' | '.join(map(str, values))} |")
    return lines


def touch_image(figures: dict) -> list[str]:
    """Table of what `perf/touch.py image` has measured."""
    lines = [
        "\n## TouchNet `image`, the paper's network\n",
        "`python perf/touch.py image --objects DIR --json build/perf/touch_image.json`: the 8 x 256 network "
        "on contacts at vertices, depth 1 mm, angle 0, soft gel; PSNR in dB, pooled, on the contacts that it "
        "was trained on and on as many others, beside the mean of the training images. It is a function of "
        "position that has learnt images, no shapes: what it has not seen it does not know. The paper trains "
        "longer, and scores 29.4 dB.",
        "",
        "| object | contacts | steps | CPU s | trained on | mean image | held out | mean image |",
        "|---" * 8 + "|",
    ]
    for row in (row for row in figures["image"] if "failed" not in row):
        names = ("known_net", "known_mean", "unknown_net", "unknown_mean")
        values = (row["object"], row["contacts"], row["steps"], f"{row['seconds']:.0f}")
        lines.append(f"| {' | '.join(map(str, (*values, *(f'{row[name]:.1f}' for name in names))))} |")
    return lines


def engine_scale(figures: dict) -> list[str]:
    """Table of what `perf/engine.py scale` has measured."""
    lines = [
        "\n## Build engine\n",
        "`python perf/engine.py scale --objects 100 1000 --json build/perf/engine_scale.json`: the real "
        "graph with commands that only write a line, two workers; wall seconds, and CPU seconds in brackets: "
        "where they are far apart, other jobs were on the machine's two cores. A stage of the first build "
        "includes the start of its shell. DVC alone: `dvc repro` on the same workspace, its first build "
        "stopped after a minute, one with nothing to do after three.",
        "",
        "| objects | stages | first build, ms per stage | engine CPU s | MB | nothing to do, s | MB "
        "| one material, stages | s | DVC: ms per stage | nothing to do, s |",
        "|---" * 11 + "|",
    ]
    for row in figures["scale"]:
        first, idle, changed = row["first"], row["idle"], row["changed"]
        stages = row["peer_stages"]
        values = (
            row["objects"],
            first["stages"],
            f"{1000 * first['seconds'] / first['ran']:.0f}",
            *(f"{first[name]:.0f}" for name in ("cpu_s", "peak_mb")),
            f"{idle['seconds']:.1f} ({idle['cpu_s']:.1f})",
            f"{idle['peak_mb']:.0f}",
            changed["ran"],
            f"{changed['seconds']:.1f} ({changed['cpu_s']:.1f})",
            f"{1000 * row['peer_s'] / stages:.0f}" if stages else "none in a minute",
            "over 180" if row["peer_idle_s"] is None else f"{row['peer_idle_s']:.0f}",
        )
        lines.append(f"| {' | '.join(map(str, values))} |")
    return lines


def engine_efficiency(figures: dict) -> list[str]:
    """What `perf/engine.py efficiency` has measured."""
    (row,) = figures["efficiency"]
    return [
        "",
        f"`python perf/engine.py efficiency`: eight objects with three stages of two seconds each keep "
        f"{row['workers']} workers busy for {row['efficiency']:.1%} of the time.",
    ]


def engine_starter(figures: dict) -> list[str]:
    """What `perf/engine.py starter` has measured."""
    (row,) = figures["starter"]
    return [
        "",
        f"`python perf/engine.py starter`: the starter catalogue from nothing takes {row['own_s']:.0f} s "
        f"with {row['workers']} workers and {row['peer_s']:.0f} s with `dvc repro`, "
        f"{row['peer_s'] / row['own_s']:.2f} times as long.",
    ]


def scores(metrics: dict[str, dict]) -> list[str]:
    """Scores of every object that `objectfolder build` has evaluated, and what the page begins with."""
    values = YAML(typ="safe").load((ROOT / "params.yaml").read_text())
    lines = [
        "# Results",
        "",
        "Regenerate: `make demo`, then geometry, modal_accuracy, modal, audio, vision, touch, engine and",
        "results in perf/; a section whose figures are not there stays as it is. Objects other than the",
        "starters were added with `objectfolder add` from YCB, Google Scanned Objects and Poly Haven.",
        "",
        f"Machine: {processor()}, one thread per stage. "
        f"Preset `{preset(values)}`, seed {values['seed']}. PSNR in dB, data in [0, 1], peak 1, "
        "on held-out data; beside every score a baseline that knows nothing.",
        *table(metrics, "vision", VISION),
        "",
        *NOISE,
        "",
        *KNOWLEDGE,
        *table(metrics, "audio", AUDIO),
        "",
        "`baseline_noise` is white Gaussian noise of each true sound's energy. `gain_error` weighs a mode by",
        "the energy of its sound, `_frobenius` by its gain; `_worst` is that of the mode at",
        "`worst_mode_hz` alone. Frequencies and decay times are stored, not learnt; their errors are the",
        "largest of any mode.",
        *table(metrics, "touch", TOUCH),
        "",
        "Ground truth and answer share the model of gel and optics: the score says what storing the geometry",
        "as an int8 grid costs, not how real the sensor is.",
        "\n## File size and noise\n",
        "| object | file KB | AWGN sigma 0.05 (vision, audio, touch) | AWGN variance 0.05 |",
        "|---|---|---|---|",
    ]
    for key, m in metrics.items():
        noise = [
            ", ".join(f"{m['awgn'][n][x]:.2f}" for x in ("vision", "audio", "touch"))
            for n in ("sigma_0_05", "variance_0_05")
        ]
        lines.append(f"| {key} | {m['file_bytes'] / 1024:.0f} | {' | '.join(noise)} |")
    lines += [
        "",
        "The paper reports 39.8 / 53.6 / 29.4 dB over its 100 objects (supplementary Table 2), "
        "with AWGN rows 32.0 / 26.2 / 24.2. "
        "In its audio convention a silent prediction scores as the `baseline_silence` column "
        "does, so compare the difference.",
    ]
    return lines


def benchmarks() -> list[str]:
    """Tables of what `objectfolder bench` has left in benchmarks/PRESET."""
    lines: list[str] = []
    objects: dict[str, None] = {}
    runs = [(task, split) for task in COMMANDS for split in splits_of(task)]
    for name in ("quick", "standard", "paper"):
        folder = Benchmarks(ROOT / "benchmarks" / name)
        for task, split in runs:
            result = folder.result(task, split)
            if not result.is_file():
                continue
            took, scores = read_json(folder.machine(task, split)), read_json(result)
            shown = tables.table(task, split, scores)
            objects |= dict.fromkeys(scores["keys"])
            of_split = f" --split {split}" if len(splits_of(task)) > 1 else ""
            lines += [
                f"\n### {shown.title}\n",
                f"`objectfolder bench {COMMANDS[task]} --preset {name}{of_split}`: "
                f"{took['seconds'] / 60:.0f} minutes with {took['threads']} thread(s), "
                f"{took['cpu_seconds'] / 60:.0f} of CPU; {took['machine']}.\n",
                shown.markdown(),
            ]
    if not lines:
        return []
    procedural = YAML(typ="safe").load(ROOT / "catalogs" / "procedural.yaml")["procedural"]
    named = [
        f"{len(keys)} {kind}: {', '.join(keys)}."
        for kind, keys in (
            ("objects of catalogs/procedural.yaml", [key for key in objects if key in procedural]),
            ("scanned objects", [key for key in objects if key not in procedural]),
        )
        if keys
    ]
    return ["\n## Benchmarks\n", *BENCHMARKS, "", *named, *lines, *measured(("photographs", photographs))]


def robots() -> list[str]:
    """Tables of what robots have left in benchmarks/PRESET, and of what `perf/grasp.py` has measured."""
    shown = measured(("grasp_labels", labels)) + measured(("grasp_speed", grasps_per_second))
    lines = robot_tables(ROOT / "benchmarks") + shown
    told = (
        "What is asked and how: [benchmarks.md](benchmarks.md#grasps). Seed 0. Minutes hold what else the "
        "machine did. Nets of explicit touches are trained apart: their difference is that of two trainings, "
        "too; rows `tested with explicit` ask one net."
    )
    return ["\n## Robots\n", told, *lines] if lines else []


def photographs(figures: dict) -> list[str]:
    """Table of what `perf/photographs.py` has measured."""
    return [
        "\n### Reconstruction from another renderer's pictures\n",
        "`python perf/photographs.py benchmarks/quick/reconstruct_seen.safetensors --observations "
        "benchmarks/quick/observations --json build/perf/photographs.json`: mean IoU of the model of views, "
        "on test views of the Object Files that it was trained with, and on path-traced pictures of meshes.",
        "",
        f"| {' | '.join(figures['mean'])} |",
        "|---" * len(figures["mean"]) + "|",
        f"| {' | '.join(f'{value:.3f}' for value in figures['mean'].values())} |",
    ]


def processor() -> str:
    models = [l for l in Path("/proc/cpuinfo").read_text().splitlines() if "model name" in l]
    return models[0].split(":")[1].strip() if models else platform.processor()


def main() -> None:
    metrics = {p.stem: json.loads(p.read_text()) for p in sorted((ROOT / "metrics").glob("*.json"))}
    lines = [
        *(scores(metrics) if metrics else []),
        *measured(("renderers", renderers)),
        *measured(("vision_training", training)),
        *measured(("vision_query", query), ("vision_primary", primary)),
        *measured(("query", queries)),
        *measured(("released", released)),
        *measured(("touch_accuracy", touch_accuracy), ("touch_speed", touch_speed)),
        *measured(("touch_query", touch_query), ("touch_dataset", touch_dataset)),
        *measured(("touch_net", touch_net)),
        *measured(("touch_image", touch_image)),
        *measured(("geometry", geometry)),
        *measured(("modal_accuracy", accuracy)),
        *measured(("modal", modal)),
        *measured(("audio", audio)),
        *measured(
            ("engine_scale", engine_scale),
            ("engine_efficiency", engine_efficiency),
            ("engine_starter", engine_starter),
        ),
        *benchmarks(),
        *robots(),
    ]
    page = ROOT / "docs" / "results.md"
    text = merged(page.read_text(), "\n".join(lines))
    with atomic(page) as path:
        path.write_text(text)


if __name__ == "__main__":
    main()
