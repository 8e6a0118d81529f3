"""`objectfolder inspect`: what the tables say, and that the pictures show something."""

import ctypes.util
import os
import re
import subprocess
import sys
from functools import cache

import numpy as np
import pytest
import pyvista
import torch
import trimesh
from folders import contents
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from PIL import Image
from refusals import refused
from rich.console import Console

from objectfolder.base.arrays import read_npz, read_safetensors, write_npz, write_png, write_safetensors
from objectfolder.base.io import atomic, read_json, write_bytes, write_curve, write_json
from objectfolder.base.materials import material
from objectfolder.mesh.grid import DistanceGrid
from objectfolder.mesh.isosurface import Isosurface
from objectfolder.mesh.normalize import normalize
from objectfolder.mesh.ply import write_surface
from objectfolder.mesh.sampling import sample_surface, split_rows
from objectfolder.mesh.sdf import distance_grid
from objectfolder.mesh.textured import TexturedMesh
from objectfolder.nets.fit import CurvePoint
from objectfolder.nets.hashgrid import HashGrid
from objectfolder.objectfile.file import ObjectFile
from objectfolder.objectfile.packing import pack_object_file
from objectfolder.report import inspect_images, inspect_nets, inspect_sound
from objectfolder.report.inspect_scene import triangles
from objectfolder.report.inspect_stage import STAGES, inspect_stage
from objectfolder.report.inspection import Inspection, print_inspection
from objectfolder.sound.fem.cutcell import cut_cells
from objectfolder.sound.fem.elements import solid_arrays, solid_from_arrays
from objectfolder.sound.fem.modal import Request, modal_analysis
from objectfolder.sound.gains_net import GainsNet, GainsShape
from objectfolder.sound.radiation.radiation import pack_radiation, radiate
from objectfolder.touch.geometric_net import GeometricTouch
from objectfolder.touch.profiles import load_profile
from objectfolder.vision.cameras import look_at, sphere_points
from objectfolder.vision.surface_net import SurfaceNet
from objectfolder.workspace.layout import MODALITIES, SPLITS, Build

SCALE = 0.2  # m
SIDES = np.array([1.0, 0.5, 0.25])  # of the box, unit frame
VOLUME = SIDES.prod() * (SCALE * 100) ** 3  # cm³


@pytest.fixture(scope="module")
def root(tmp_path_factory, opengl):
    """A workspace with every artifact of one small box."""
    root = tmp_path_factory.mktemp("workspace")
    build, rng = Build("brick", root), np.random.default_rng(0)
    vertices, faces = _geometry(build, _box())
    _solid_and_modes(build, vertices, faces, rng)
    _datasets(build, vertices, faces, rng)
    _nets(build)
    write_json(build.metrics, {"vision": {"psnr": 31.25}, "touch": {"psnr": 26.02}, "file_bytes": 7})
    for sheet in (build.vision_sheet, build.sound_sheet):
        write_png(sheet, np.zeros((4, 4, 3), np.uint8))
    return root


@pytest.fixture(scope="module")
def build(root):
    return Build("brick", root)


def _box():
    mesh = trimesh.creation.box(SIDES).subdivide().subdivide()
    colors = np.full((len(mesh.vertices), 3), (200, 120, 40), np.uint8)
    return TexturedMesh(mesh.vertices, mesh.faces, vertex_colors=colors)


def _geometry(build, mesh):
    """Write what the stage normalize writes; return the surface."""
    result = normalize(mesh)
    _write_visual(build, result.visual)
    with atomic(build.surface) as path:
        write_surface(path, result.surface.mesh)
    write_json(build.normalize, result.report(SCALE, "z"))
    return result.surface.mesh


def _write_visual(build, mesh):
    with atomic(build.visual) as path:
        mesh.write_glb(path)


def _solid_and_modes(build, vertices, faces, rng):
    cells = cut_cells(vertices, faces, 6, 4)
    write_npz(build.solid, **solid_arrays(cells))
    values, band = distance_grid(vertices, faces, 32)
    write_npz(build.sdf, values=values, band=band)
    points = np.concatenate([vertices, sample_surface(vertices, faces, 20, rng)])
    data = modal_analysis(cells, points, Request(material("ceramic"), SCALE, 20000.0, 8))
    write_npz(build.modes, points=points, split=split_rows(len(points), rng), **data.arrays())
    write_json(build.modal, data.report)
    surface = vertices * SCALE, faces
    field = radiate(surface, points * SCALE, data.shapes, data.damped_frequency, 200)
    write_safetensors(build.radiation, *pack_radiation(field, surface, SCALE, 50_000))


def _datasets(build, vertices, faces, rng):
    for split, count in zip(SPLITS, (20, 3, 4)):
        rgba = np.zeros((count, 16, 16, 4), np.float16)
        rgba[:, 4:12, 4:12, 3] = 1  # a quarter of the image, whose upper half is lit
        rgba[:, 4:8, 4:12, :3] = 0.5
        views = {"rgba": rgba, "camera_to_world": look_at(sphere_points(count, 2.5, rng))}
        views |= {"light": sphere_points(count, 1.0, rng), "focal": np.float64(22.2), "renderer": "mitsuba"}
        write_npz(build.views(split), **views, center=np.full((count, 2), 2.5 if split == "train" else 8.0))
        touches = {"images": rng.integers(0, 256, (count, 16, 12, 3)).astype(np.uint8)}
        touches |= {"points": sample_surface(vertices, faces, count, rng) * SCALE, "angles": np.zeros(count)}
        touches |= {"normals": np.tile([0.0, 0, 1], (count, 1)), "depths": np.linspace(5e-4, 15e-4, count)}
        write_npz(build.touch(split), **touches, obstructed=np.where(np.arange(count) == 0, 0.3, 0.0))
    for sheet in (build.views_sheet, build.touch_sheet):
        write_png(sheet, np.zeros((4, 4, 3), np.uint8))


def _nets(build):
    sdf, modes = read_npz(build.sdf), read_npz(build.modes)
    with torch.random.fork_rng():
        torch.manual_seed(0)
        vision, header = SurfaceNet(HashGrid(2, 2, 6, 4, 8), 8, 0.5, 0.0).to_tensors()
        write_safetensors(build.net("vision"), vision, {"kind": "surface", "net": header})
        damped, damping = (torch.from_numpy(modes[name]) for name in ("damped_frequency", "damping"))
        ones, used = torch.ones(len(damping)), torch.ones(4**3, dtype=torch.bool)
        audio, header = GainsNet(damped, damping, ones, used, GainsShape(2, 3, 8, 8, 6.0)).to_tensors()
        write_safetensors(build.net("audio"), audio, {"kind": "gains", "net": header})
    touch = GeometricTouch(Isosurface(DistanceGrid.from_arrays(sdf)), SCALE, load_profile("digit"))
    mean = np.full((160, 120, 3), 100, np.uint8)
    _, header = touch.to_tensors()
    write_safetensors(build.net("touch"), {"background": mean}, {"kind": "geometric", "net": header})
    curve = [CurvePoint(10, 0.5, 0.6, 1.0), CurvePoint(20, 0.1, 0.25, 2.0), CurvePoint(30, 0.05, 0.3, 3.0)]
    for modality in MODALITIES:
        write_curve(build.curve(modality), curve)
    nets = {modality: read_safetensors(build.net(modality)) for modality in MODALITIES}
    modal, normal = read_json(build.modal), read_json(build.normalize)
    header, tensors = pack_object_file("brick", modal, normal, sdf, nets, {"sdf": "ab" * 32})
    write_safetensors(build.object_file, tensors, header)


@cache
def _inspected(root, stage):
    return inspect_stage(stage, "brick", root)


def _rows(root, stage):
    return dict(_inspected(root, stage).rows)


SLOW = {stage: pytest.param(stage, marks=pytest.mark.slow) for stage in ("radiation", "voxelize")}


@pytest.mark.parametrize("stage", [SLOW.get(stage, stage) for stage in STAGES])
def test_pictures_show_something_and_nothing_declared_changes(root, build, stage):
    before = {name: held for name, held in contents(root).items() if "/inspect/" not in name}
    inspection = _inspected(root, stage)
    assert inspection.title == f"{stage}@brick"
    assert inspection.files == []
    if stage == "evaluate":  # has its own
        assert inspection.pictures == [build.vision_sheet, build.sound_sheet]
        return
    for path in inspection.pictures[:1]:
        assert path == build.dir / "inspect" / f"{stage}.png"
        with Image.open(path) as image:
            pixels = np.asarray(image.convert("RGB"), np.float64)
        assert pixels.std() > 5
        assert min(pixels.shape[:2]) > 400
    assert contents(root).items() >= before.items()
    assert not list(root.rglob(".*.tmp*"))


#: Values of rows by stage; ``...`` at an end stands for anything.
ROWS = {
    "normalize": {
        "size": "200.00 x 100.00 x 50.00 mm (x, y, z)",
        "volume": f"{VOLUME:.4f} cm³",
        "area": "700.000 cm²",  # 2 (20 10 + 20 5 + 10 5)
        "holes through it": "0",
        "surface": "...192 faces, 1 body",
        "visual to surface": "at most 0 mm apart",
    },
    "voxelize": {"volume of the surface": f"{VOLUME:.4f} cm³", "distance grid": "32^3 samples, 6.7097 mm..."},
    "radiation": {"modes": "8"},
    "render_views": {
        "  pixels": "object covers 25.0% of the image; 50.0% of that is lit",
        "  camera distance": "2.5 to 2.5 sizes",
    },
    "render_touch": {"  press depths": "0.5 to 1.5 mm"},
    "train_audio": {"best validation loss": "0.25 at step 20", "last training loss": "0.05"},
    "pack": {
        **{"material": "ceramic", "geometry.resolution": "32", "touch.net.sensor": "digit"},
        **{"made from sdf": "ab" * 6, "  touch.background": "uint8 160x120x3, 57.6 kB"},
    },
    "evaluate": {
        "file_bytes": "7 bytes",
        "touch.psnr": "26.02 dB, higher is better",
        "vision.psnr": "31.25 dB, higher is better",
    },
}


@pytest.mark.parametrize("stage", ROWS)
def test_rows(root, stage):
    rows = _rows(root, stage)
    for name, value in ROWS[stage].items():
        pattern = re.escape(value).replace(re.escape("..."), ".*")
        assert re.fullmatch(pattern, rows[name]), (name, rows[name])
    if stage == "evaluate":
        assert [*rows] == [*ROWS[stage]]


def test_radiation_tells_the_ball_about_the_box(root):
    radius = _rows(root, "radiation")["ball that holds the surface"].split()[0]
    assert float(radius) == pytest.approx(0.573, abs=0.01)


def test_normalize_tells_when_the_meshes_are_in_different_frames(tmp_path, opengl):
    build, mesh = Build("brick", tmp_path), _box()
    _geometry(build, mesh)
    x, y, z = mesh.vertices.T
    _write_visual(build, mesh.with_vertices(np.stack([x, -z, y], 1)))
    # The cross-section of 100 mm x 50 mm is turned by 90°.
    assert _rows(tmp_path, "normalize")["visual to surface"] == "at most 25 mm apart"


def test_normalize_counts_pieces_and_holes(tmp_path, opengl):
    """A plate with two holes and a cavity, beside a lump that a bridge joins to it."""
    parts = [trimesh.creation.box(sides) for sides in ((1, 0.4, 0.2), *[(0.2, 0.2, 1)] * 2, (0.1, 0.1, 0.1))]
    for part, x in zip(parts[1:], (-0.25, 0.25, 0)):
        part.apply_translation([x, 0, 0])
    plate = trimesh.boolean.difference(parts, engine="manifold")
    lump = trimesh.creation.icosphere(3, radius=0.05).apply_translation([0, 0, 0.155])
    mesh = trimesh.util.concatenate([plate, lump])
    _geometry(Build("plate", tmp_path), TexturedMesh(np.array(mesh.vertices), np.array(mesh.faces, np.int64)))
    rows = dict(inspect_stage("normalize", "plate", tmp_path).rows)
    assert rows["holes through it"] == "2"
    assert rows["surface"].endswith("1 body, 1 cavity")
    assert "bridge: 1 gap up to 0.500% of the size filled (volume +" in rows["closed by"]


def test_voxelize_rows(root, build):
    cells = solid_from_arrays(read_npz(build.solid))
    rows = _rows(root, "voxelize")
    assert rows["cells"].startswith(f"{len(cells.index)} of 6^3, 33.337 mm")
    full, cut = int(rows["full cells"]), int(rows["cut cells"].partition(",")[0])
    assert full + cut == len(cells.index)
    histogram = [int(value) for name, value in rows.items() if name.startswith("  fill")]
    assert sum(histogram) == len(cells.index)
    assert float(rows["volume of the cells"].split()[0]) == pytest.approx(VOLUME, rel=2e-3)
    assert float(rows["inside samples"].split()[1]) == pytest.approx(VOLUME, rel=0.15)


def test_vtu_is_the_solid_in_metres(root, build):
    cells = solid_from_arrays(read_npz(build.solid))
    (path,) = inspect_stage("voxelize", "brick", root, vtu=True).files
    grid = pyvista.read(path)
    assert grid.n_cells == len(cells.index)
    assert set(grid.celltypes) == {pyvista.CellType.HEXAHEDRON}
    assert grid.n_points < 8 * grid.n_cells  # neighbours share their corners
    volumes = grid.compute_cell_sizes()["Volume"]  # positive if the corners are in VTK's order
    np.testing.assert_allclose(volumes, (cells.cell_size * SCALE) ** 3)
    assert volumes @ grid.cell_data["fill"] * cells.correction == pytest.approx(cells.volume * SCALE**3)
    centres = grid.cell_centers().points / SCALE
    np.testing.assert_allclose(centres, (cells.index + 0.5) * cells.cell_size + cells.lower, atol=1e-7)


def test_modal_rows(root, build):
    modes, rows = read_npz(build.modes), _rows(root, "modal")
    damping, hertz = modes["damping"], modes["damped_frequency"] / (2 * np.pi)
    told, _, _, decay, _, _, quality, *_ = rows["  mode 1"].replace(",", "").split()
    assert float(told) == pytest.approx(hertz[0], abs=0.005)
    assert float(decay) == float(f"{np.log(1000) / damping[0]:.3g}")
    assert float(quality) == pytest.approx(np.sqrt(modes["eigenvalues"][0]) / (2 * damping[0]), rel=1e-3)
    assert rows["modes"].startswith(f"{len(damping)}, of which ")
    assert hertz.max() > 10000
    assert rows["frequencies"] == f"{hertz.min():,.0f} to {hertz.max():,.0f} Hz"
    assert rows["files"] == f"{(build.modes.stat().st_size + build.modal.stat().st_size) / 1000:,.1f} kB"
    assert float(rows["material"].split()[1]) == pytest.approx(VOLUME * 2.7, rel=2e-3)


def copied_modes(source, folder, **changed):
    """Rows of an inspection of the same modes, of which the report says other things."""
    build = Build("brick", folder)
    for name in ("modes", "surface"):
        write_bytes(getattr(build, name), getattr(source, name).read_bytes())
    write_json(build.modal, read_json(source.modal) | changed)
    return _rows(folder, "modal")


@pytest.mark.parametrize(
    ("errors", "row", "first", "second"),
    [
        ([0.012345, 0.2], "of the lowest 2 frequencies: up to 20.00%", "1.23%", "20.00%"),
        (None, "not known", None, None),
    ],
)
def test_modal_tells_the_estimated_error(tmp_path, build, monkeypatch, errors, row, first, second):
    monkeypatch.setattr(inspect_sound, "_modal_picture", lambda *arguments: None)
    rows = copied_modes(build, tmp_path, discretisation_error=errors)
    assert rows["estimated error"] == row
    for mode, error in ((1, first), (2, second), (3, None)):
        told = rows[f"  mode {mode}"].partition(", estimated error ")[2]
        assert told == (error or "")


@pytest.mark.slow
def test_modal_tells_of_a_reused_solve(tmp_path, root, build):
    rows = copied_modes(build, tmp_path, reused=True, count_below_max_frequency=None, truncated=True)
    assert rows["below 20 kHz"] == "not counted (truncated)"
    assert rows["solved"] == "no: scaled from an earlier solve"
    assert "solved" not in _rows(root, "modal")


def test_modal_of_an_object_without_modes(tmp_path, build):
    source, build = build, Build("brick", tmp_path)
    modes, report = read_npz(source.modes), read_json(source.modal)
    for name in ("eigenvalues", "damping", "damped_frequency", "residuals"):
        modes[name] = modes[name][:0]
    modes["shapes"] = modes["shapes"][:, :, :0]
    write_npz(build.modes, **modes)
    write_json(build.modal, report | {"modes": 0, "modes_below_8_kHz": 0})
    build.surface.write_bytes(source.surface.read_bytes())
    assert _rows(tmp_path, "modal")["modes"] == "0, of which 0 below 8 kHz"
    assert _inspected(tmp_path, "modal").pictures == []


def test_splits_have_rows_of_their_own(root):
    rows = _inspected(root, "render_views").rows
    kinds = [value.partition(",")[0] for name, value in rows if name in SPLITS]
    assert kinds == ["20 tiles", "3 views", "4 views"]
    rows = _inspected(root, "render_touch").rows
    shares = [value.partition(" of the contacts")[0] for name, value in rows if name == "  obstructed"]
    assert shares == ["5.0%", "33.3%", "25.0%"]


def drawn(monkeypatch, module, root, stage):
    """Figure that a module of `objectfolder.report` draws of a stage."""
    figures = []
    monkeypatch.setattr(module, "save_page", lambda figure, path: figures.append(figure) or path)
    inspect_stage(stage, "brick", root)
    figures[0].draw_without_rendering()
    return figures[0]


def test_the_legend_of_directions_hides_none(root, monkeypatch):
    figure = drawn(monkeypatch, inspect_images, root, "render_views")
    (legend,) = figure.findobj(Legend)
    assert [text.get_text() for text in legend.get_texts()] == ["train (20)", "val (3)", "test (4)"]
    plots = [axes for axes in figure.findobj(Axes) if axes.get_xlabel() == "azimuth [°]"]
    assert len(plots) == 2
    assert not any(legend.get_window_extent().overlaps(axes.get_window_extent()) for axes in plots)


def test_test_views_are_shown_best_lit_first(build):
    views = read_npz(build.views("test"))
    views["rgba"] = views["rgba"].copy()
    views["rgba"][[0, 2], ..., :3] = 0  # black
    panels = Figure().subplots(2, 3)
    inspect_images._show_views(panels, views)
    azimuth, _ = inspect_images._angles(views["camera_to_world"][:, :3, 3])
    titles = [axes.get_title().partition("°")[0] for axes in panels.flat]
    assert titles == [*(f"az {azimuth[row]:.0f}" for row in (1, 3, 0, 2)), "", ""]


def test_levels_over_directions_have_a_scale(root, monkeypatch):
    found = drawn(monkeypatch, inspect_sound, root, "radiation").findobj(Axes)
    (scale,) = [axes for axes in found if axes.get_ylabel() == "dB relative to the loudest direction"]
    assert scale.get_ylim() == (-30, 0)


def copied_net(source, folder, modality, curve):
    build = Build("brick", folder)
    write_curve(build.curve(modality), curve)
    write_bytes(build.net(modality), source.net(modality).read_bytes())


@pytest.mark.parametrize(("losses", "scale"), [((2e-6, 1.9e-6), "linear"), ((0.5, 0.01), "log")])
def test_a_curve_is_drawn_from_zero_unless_it_falls_by_a_decade(tmp_path, build, monkeypatch, losses, scale):
    curve = [CurvePoint(n + 1, loss, loss, 1.0) for n, loss in enumerate(losses)]
    copied_net(build, tmp_path, "touch", curve)
    (axes,) = drawn(monkeypatch, inspect_nets, tmp_path, "train_touch").findobj(Axes)
    assert axes.get_yscale() == scale
    assert (axes.get_ylim()[0] == 0) == (scale == "linear")
    assert all(tick == round(tick) for tick in axes.get_xticks())


def test_train_of_an_object_with_nothing_to_learn(tmp_path, build):
    copied_net(build, tmp_path, "audio", [])
    assert _rows(tmp_path, "train_audio")["curve"].startswith("empty")
    assert _inspected(tmp_path, "train_audio").pictures == []


def test_sizes_and_numbers_are_those_of_the_files(root, build):
    tensors, _ = read_safetensors(build.net("audio"))
    count = sum(tensor.size for tensor in tensors.values())
    assert _rows(root, "train_audio")["tensors"].split()[1] == f"{count:,}"
    rows, file = _rows(root, "pack"), ObjectFile.load(build.object_file)
    assert rows["file"] == f"{build.object_file.stat().st_size / 1000:,.1f} kB"
    lowest, highest = (f"{hertz:,.0f}" for hertz in (file.frequencies.min(), file.frequencies.max()))
    assert rows["modes"] == f"{len(file.frequencies)}, {lowest} to {highest} Hz"
    count = sum(tensor.nbytes for tensor in file.tensors.values())
    assert rows["tensors"].endswith(f"numbers, {count / 1000:,.1f} kB")


def test_the_picture_of_a_strike_has_its_quantity_and_unit(root, build, monkeypatch):
    figure, label = drawn(monkeypatch, inspect_nets, root, "pack"), "[$10^{-6}$ m kg$^{1/2}$]"
    (axes,) = [axes for axes in figure.findobj(Axes) if axes.get_ylabel().endswith(label)]
    assert axes.get_ylabel() == f"sum of modal displacements {label}"
    file = ObjectFile.load(build.object_file)
    expected = file.impact(file.sample_surface(4)[:1], [[0.0, 0, 1]], 40000)[0]
    np.testing.assert_allclose(axes.lines[0].get_ydata(), 1e6 * expected, rtol=1e-6)


@pytest.mark.parametrize(
    ("name", "value", "shown"),
    [
        ("vision.psnr_lit_foreground", 27.29923, "27.3 dB, higher is better"),
        ("vision.ssim", 0.98445, "0.9845, higher is better"),
        ("vision.noise_floor_lit", 34.48421, "34.48 dB"),
        ("vision.baseline_white", 8.29706, "8.297 dB"),
        ("vision.views", 24, "24"),
        ("audio.gain_error_frobenius", 0.00587249, "0.5872 %, lower is better"),
        ("audio.baseline_nearest", 0.0362103, "3.621 %"),
        ("audio.baseline_silence", 49.3994, "49.4 dB"),
        ("audio.lost_energy", 0.0, "0 %, lower is better"),
        ("audio.worst_mode_hz", 18756.2, "18760 Hz"),
        ("touch.baseline_mean_image", 32.91123, "32.91 dB"),
        ("touch.obstructed_fraction", 0.0625, "6.25 %"),
        ("file_sha256", "ab" * 32, "ab" * 32),
    ],
)
def test_scores_have_their_units(name, value, shown):
    assert inspect_nets._score(name, value) == shown


def test_unknown_stages_wrong_keys_and_vtu_of_another_stage_are_refused(tmp_path):
    refused("'modl'; did you mean modal", inspect_stage, "modl", "brick", tmp_path)
    refused("expected one of normalize, voxelize", inspect_stage, "xyz", "brick", tmp_path)
    refused("not a valid object key", inspect_stage, "modal", "../brick", tmp_path)
    refused("inspect voxelize@brick --vtu", inspect_stage, "modal", "brick", tmp_path, vtu=True)


@pytest.mark.parametrize("stage", STAGES)
def test_missing_artifact_says_what_to_build(tmp_path, stage):
    advice = f"does not exist; run `objectfolder build {stage}@brick`"
    refused(advice, inspect_stage, stage, "brick", tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
@pytest.mark.skipif(
    not sys.platform.startswith("linux") or ctypes.util.find_library("OSMesa") is not None,
    reason="needs VTK's off-screen window to be unusable",
)
def test_without_opengl_the_error_says_what_to_install():
    code = "from objectfolder.report.inspect_scene import draw_scene; draw_scene(lambda plotter: None)"
    environment = os.environ | {"VTK_DEFAULT_OPENGL_WINDOW": "vtkOSOpenGLRenderWindow"}
    ran = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True)
    assert ran.returncode == 1
    assert "ObjectFolderError" in ran.stderr
    assert "apt-get install libegl1 libgl1-mesa-dri" in ran.stderr


def test_without_pyvista_the_error_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyvista", None)
    refused(r"pyvista is not installed; .*\[inspect\]", triangles, np.eye(3), np.array([[0, 1, 2]]))


def test_print_keeps_brackets(capsys):
    inspection = Inspection("pack@brick", [("list", "[red]1[/red]")], [], [])
    print_inspection(inspection, Console(width=80, force_terminal=False))
    assert "[red]1[/red]" in capsys.readouterr().out
