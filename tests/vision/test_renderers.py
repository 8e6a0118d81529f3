"""What all renderers have in common; those that are not installed are skipped."""

import os
import stat
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import get_args

import mitsuba
import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from refusals import refused
from solids import box, join, sphere

from objectfolder.base.errors import ObjectFolderError
from objectfolder.mesh.normals import unit_vectors
from objectfolder.mesh.raycast import RayCaster
from objectfolder.mesh.textured import TexturedMesh
from objectfolder.vision.bsdf import principled
from objectfolder.vision.cameras import (
    Intrinsics,
    camera_rays,
    covered_rectangle,
    look_at,
    project,
    sphere_points,
)
from objectfolder.vision.renderers import blender_scene, cycles
from objectfolder.vision.renderers.registry import NEEDS, RENDERERS, make_renderer
from objectfolder.vision.scene import Scene
from objectfolder.vision.settings import RendererName
from objectfolder.vision.truth import Frames, render_frames
from objectfolder.workspace.presets import read_preset

ROOT = Path(__file__).parents[2]
FRONT = look_at(np.array([2.5, 0, 0]))[0]
ASIDE = look_at(np.array([1.5, 2.0, 0]))[0]  # sees the square at x = 0 without its highlight
SMALL = Intrinsics.square(33)
LARGE = Intrinsics(65, 65, 150.0)
MIDDLE = (16, 16)
SQUARE = np.array([[0, -0.5, -0.5], [0, 0.5, -0.5], [0, 0.5, 0.5], [0, -0.5, 0.5]])
HALVES = np.array([[0, 1, 2], [0, 2, 3]])
RED = np.full((4, 4, 3), [200, 120, 40], np.uint8)


def lacking(name):
    """Why a renderer cannot run here; empty if it can."""
    try:
        make_renderer(name, Scene(TexturedMesh(SQUARE, HALVES)))
    except ObjectFolderError as error:
        return str(error)
    return ""


LACKING = {name: lacking(name) for name in RENDERERS}
HERE = [name for name, reason in LACKING.items() if not reason]


@pytest.mark.parametrize("name", RENDERERS)
def test_the_renderer_runs_here(name):
    """Else the tests below leave it out."""
    if LACKING[name] and name != "mitsuba":
        pytest.skip(LACKING[name])
    assert not LACKING[name]


@pytest.fixture(params=HERE)
def render(request):
    """Render a mesh with each renderer that can run here."""

    def rendered(mesh, light, pose=FRONT, intrinsics=SMALL, samples=16, ambient=0.0):
        renderer = make_renderer(request.param, Scene(mesh, ambient))
        return renderer.render(pose, np.asarray(light, float), intrinsics, samples, 1)

    rendered.name = request.param
    return rendered


def square(**appearance):
    return TexturedMesh(SQUARE, HALVES, **{"roughness": 1.0, **appearance})


def colors(color, count=4):
    return np.tile(np.uint8(color), (count, 1))


def painted(solid, color=(255, 255, 255), **material):
    return TexturedMesh(*solid, vertex_colors=colors(color, len(solid[0])), **material)


def test_a_rough_white_surface_facing_the_light_at_distance_one_has_radiance_near_one(render):
    """One exactly for a Lambertian; BSDFs differ by what their surface reflects above it."""
    white = square(vertex_colors=colors([255] * 3))
    image = render(white, [1, 0, 0], ASIDE, samples=256)
    assert image[MIDDLE][3] == 1
    np.testing.assert_allclose(image[MIDDLE][:3], 1, atol=0.1)
    if render.name == "mitsuba":  # the principled BSDF adds its highlight and retroreflection
        front, view = torch.tensor([[1.0, 0, 0]]), torch.tensor([[-0.6, -0.8, 0]])
        expected = principled(front, view, front, torch.ones(1, 3), 1.0, 0.0)[0]
        np.testing.assert_allclose(image[MIDDLE][:3], expected, rtol=0.01)
        np.testing.assert_allclose(expected, 1, atol=0.03)


def test_radiance_falls_with_the_square_of_distance(render):
    grey = square()
    near, far = (render(grey, [d, 0, 0], ASIDE)[MIDDLE][0] for d in (1, 2))
    assert near / far == pytest.approx(4, rel=0.05)


def test_without_colours_or_coordinates_of_its_texture_the_surface_is_grey(render):
    meshes = square(), square(texture=RED), square(vertex_colors=colors([203] * 3))  # 0.6 in linear
    bare, lost, grey = (render(mesh, [1, 0, 0], ASIDE) for mesh in meshes)
    np.testing.assert_array_equal(lost, bare)
    np.testing.assert_allclose(bare[MIDDLE], grey[MIDDLE], atol=0.01)


def test_vertex_colours_equal_a_texture_of_that_colour(render):
    meshes = square(uv=SQUARE[:, 1:] + 0.5, texture=RED), square(vertex_colors=colors(RED[0, 0]))
    a, b = (render(mesh, [1.5, 0.2, 0])[10:22, 10:22] for mesh in meshes)
    np.testing.assert_allclose(a, b, rtol=5e-3)


def test_a_texture_is_upright_and_repeats(render):
    texture = np.zeros((16, 16, 3), np.uint8)
    texture[:8, :8] = [200, 0, 0]  # upper left
    texture[8:, 8:] = [0, 0, 200]  # lower right
    for shift in (0, 3):
        image = render(square(uv=SQUARE[:, 1:] + 0.5 + shift, texture=texture), [2, 0, 0])
        # Seen from +x, y runs to the right and z up.
        corners = np.array([[0, -0.25, 0.25], [0, 0.25, -0.25]])
        (left, upper), (right, lower) = project(corners, FRONT, SMALL)[0].astype(int)
        assert image[upper, left, 0] > 4 * image[upper, left, 2]
        assert image[lower, right, 2] > 4 * image[lower, right, 0]


def test_vertex_colours_are_srgb_and_interpolated(render):
    mesh = square(vertex_colors=np.uint8([[188, 0, 0], [0, 0, 188], [0, 0, 188], [188, 0, 0]]))
    image = render(mesh, [2, 0, 0])
    (left, row), (right, _) = project(np.array([[0, -0.4, 0], [0, 0.4, 0]]), FRONT, SMALL)[0].astype(int)
    assert image[row, left, 0] > 2 * image[row, left, 2]
    assert image[row, right, 2] > 2 * image[row, right, 0]
    middle = image[MIDDLE]
    assert middle[0] == pytest.approx(middle[2], rel=0.15)


def test_metal_reflects_in_its_colour_and_has_no_diffuse_light(render):
    gold, paint = (square(vertex_colors=colors([255, 180, 0]), roughness=0.3, metallic=m) for m in (1.0, 0.0))
    aside = look_at(np.array([0.6, 2.4, 0]))[0]
    assert render(gold, [1, 0, 0], aside)[MIDDLE][0] < 0.2 * render(paint, [1, 0, 0], aside)[MIDDLE][0]
    highlight = render(gold, [1.5, 0, 0])[MIDDLE]
    assert highlight[2] < 0.2 * highlight[0]
    mirror = painted(sphere(0.3, 3), metallic=1.0, roughness=0.0)
    assert np.isfinite(render(mirror, [1, 1, 1])).all()


@pytest.mark.parametrize(
    "intrinsics",
    [
        Intrinsics(48, 36, 60.0),
        Intrinsics(48, 36, 60.0, center=(29.0, 14.5)),
        Intrinsics(30, 50, 60.0, center=(13.0, 20.0), focal_y=75.0),
        Intrinsics(40, 36, 60.0, center=(22.0, 20.0), focal_y=50.0),
    ],
    ids=["centred", "off centre", "pixels wider than high", "pixels higher than wide"],
)
def test_the_silhouette_is_where_the_camera_sees_it(render, intrinsics):
    if render.name.startswith("mitsuba") and intrinsics.fx != intrinsics.fy:
        with pytest.raises(ObjectFolderError, match="pixels are square, but focal lengths are 60, "):
            render(square(), [1, 0, 0], intrinsics=intrinsics)
        return
    for position in ((2.5, 0, 0), (-1.2, 1.7, 1.1), (0, 0, -2.5)):
        pose = look_at(np.array(position))[0]
        alpha = render(painted(sphere(0.1, 3, (0.1, -0.3, 0.2))), [1, 1, 1], pose, intrinsics)[..., 3]
        (centre,), _ = project(np.array([[0.1, -0.3, 0.2]]), pose, intrinsics)
        rows, columns = np.mgrid[: intrinsics.height, : intrinsics.width] + 0.5
        assert (alpha * columns).sum() / alpha.sum() == pytest.approx(centre[0], abs=0.1)
        assert (alpha * rows).sum() / alpha.sum() == pytest.approx(centre[1], abs=0.1)
        assert alpha.max() == 1
        assert alpha[0].max() == 0


def test_a_light_behind_leaves_the_near_side_dark(render):
    image = render(painted(sphere(0.4, 4)), [-1.0, 0, 0])
    assert (image[..., 3] == 1).sum() > 100
    assert image[..., :3].max() <= 0.002  # the rasteriser's cosine is 0.001 at least


def test_a_camera_inside_sees_the_surface_from_inside(render):
    """Which the light outside does not reach; the rasteriser knows no shadows."""
    inside = look_at(np.array([0.05, 0, 0]))[0]
    image = render(painted(box((0.8, 0.8, 0.8))), [0, 0, 1.0], inside)
    assert (image[..., 3] == 1).all()
    assert np.isfinite(image).all()
    if render.name != "raster":
        assert image[..., :3].max() == 0
    lamp = render(painted(box((0.8, 0.8, 0.8))), [0.1, 0.1, 0.1], inside)
    if render.name != "raster":
        assert lamp[..., :3].min() > 0.1


@pytest.mark.parametrize("distance", [0.003, 0.0099, 0.0101, 990.0])
def test_a_camera_sees_a_surface_right_before_it_and_far_away(render, distance):
    pose = look_at(np.array([distance, 0, 0]))[0]
    assert (render(square(), [1, 0, 0], pose, Intrinsics(9, 9, 9 * max(distance * 2, 1)))[..., 3] == 1).all()


@pytest.mark.parametrize("distance", [4.0, 10.0])
def test_a_camera_that_looks_past_the_object_sees_it(render, distance):
    """Depths along its axis, 45 degrees aside, are shorter than distances."""
    pose = look_at(np.array([distance, 0, 0]), (0, distance, 0))[0]
    focal = 66 * distance
    pixels = Intrinsics(33, 33, focal, (16.5 + focal, 16.5))
    assert (render(square(), [1, 0, 0], pose, pixels)[..., 3] == 1).all()


@pytest.mark.parametrize("light", [[0, 0, 0], [0, 0.2, 0.1], [1e-7, 0, 0]])
def test_a_light_on_the_surface_gives_a_finite_picture(render, light):
    image = render(square(), light)
    assert np.isfinite(image).all()
    assert image[MIDDLE][3] == 1


def test_a_picture_of_one_pixel_and_one_without_the_object(render):
    for width, height in ((1, 1), (2, 7)):
        image = render(square(), [1, 0, 0], intrinsics=Intrinsics(width, height, 70.0))
        assert image.shape == (height, width, 4)
        assert (image[..., 3] == 1).all()
    away = look_at(np.array([2.5, 0, 0]), (5, 0, 0))[0]
    assert not render(square(), [1, 0, 0], away).any()


def test_the_same_seed_gives_the_same_bytes(render):
    mesh = painted(box((0.5, 0.4, 0.3)))
    first, second = (render(mesh, [1, 0.2, 0.5], samples=4) for _ in range(2))
    assert first.dtype == np.float32
    assert first.tobytes() == second.tobytes()


def test_ambient_light_of_an_open_white_surface_is_its_radiance(render):
    mesh = square(vertex_colors=colors([255] * 3))
    image = render(mesh, [-1, 0, 0], ASIDE, samples=64, ambient=0.25)
    behind = render(mesh, [-1, 0, 0], ASIDE, samples=64)
    np.testing.assert_allclose(image[MIDDLE][:3] - behind[MIDDLE][:3], 0.25, rtol=0.15)
    np.testing.assert_array_equal(image[..., 3], behind[..., 3])
    assert not image[0].any()  # the room is not in the picture


def test_normals_shade_a_coarse_sphere_nearly_as_a_fine_one(render):
    light, (vertices, faces) = [1.0, 0.3, 0.5], sphere(0.4, 3)
    flat = painted((vertices, faces), roughness=1.0)
    meshes = painted(sphere(0.4, 5), roughness=1.0), flat, replace(flat, normals=vertices / 0.4)
    fine, *images = (render(mesh, light, intrinsics=LARGE, samples=64) for mesh in meshes)
    inside = (images[0][..., 3] == 1) & (fine[..., 3] == 1) & (fine[..., 0] > 0.2)  # not in its own shadow
    rough, smooth = (np.abs(image - fine)[inside][:, :3].mean() for image in images)
    assert smooth < 0.35 * rough
    np.testing.assert_allclose(images[0][..., 3], images[1][..., 3], atol=0.1)


def test_a_square_with_tilted_normals_receives_light_by_their_cosine(render):
    tilt = np.array([np.sqrt(0.75), 0, 0.5])
    straight, tilted = (
        render(square(normals=np.tile(n, (4, 1))), [0.99, 0, 0], ASIDE)[MIDDLE][0]
        for n in (np.array([1.0, 0, 0]), tilt)
    )
    assert tilted / straight == pytest.approx(np.sqrt(0.75), rel=0.03)
    assert render(square(), [0.99, 0, 0], ASIDE)[MIDDLE][0] == pytest.approx(straight, rel=1e-4)


def test_a_turned_mesh_under_turned_camera_and_light_is_the_same_picture(render):
    def turn(vectors):
        return np.asarray(vectors, float)[..., [2, 0, 1]]

    vertices, faces = sphere(0.4, 2)
    stretched = painted((vertices * [1, 0.7, 0.5], faces))
    mesh = replace(stretched, normals=unit_vectors(vertices / [1, 0.7, 0.5]))
    light, eye = np.array([1.0, 0.3, 0.5]), np.array([2.5, 0.4, 0.9])
    pose = look_at(eye)[0]
    turned = np.eye(4)
    turned[:3] = turn(pose[:3].T).T
    first = render(mesh, light, pose, LARGE)
    second = render(mesh.rotate(turn), turn(light), turned, LARGE)
    flat = render(stretched, light, pose, LARGE)
    assert np.abs(first - second).mean() < 0.05 * np.abs(first - flat).mean()


@pytest.mark.parametrize("name", [name for name in HERE if name not in ("mitsuba", "raster")])
def test_path_tracers_agree_with_mitsuba(name):
    """Up to their BSDFs; nothing is tuned."""
    rng = np.random.default_rng(4)
    solid = box((0.5, 0.6, 0.7))
    mesh = painted(solid, (200, 120, 60))
    truth, other = (make_renderer(n, Scene(mesh)) for n in ("mitsuba", name))
    for pose, light in zip(look_at(sphere_points(3, 2.5, rng)), sphere_points(3, 1.0, rng)):
        a, b = (r.render(pose, light, SMALL, 64, 1) for r in (truth, other))
        assert np.abs(a - b).mean() < 0.01
        assert np.abs(a[..., 3] - b[..., 3]).max() < 0.2


def test_the_names_in_the_parameters_are_those_of_the_renderers():
    names = get_args(RendererName)
    assert set(names) == set(RENDERERS) == set(NEEDS)


def test_an_unknown_renderer_is_refused_with_the_known_ones():
    refused(r"'povray' is not one of mitsuba, .*cycles, raster", make_renderer, "povray", Scene(square()))


@pytest.mark.parametrize(
    ("name", "module", "extra"),
    [
        ("cycles", "bpy", r"cycles .* or Blender"),
        ("raster", "pyrender", "raster"),
        ("mitsuba", "mitsuba", "build"),
    ],
)
def test_renderers_that_are_not_installed_say_which_extra(monkeypatch, name, module, extra):
    monkeypatch.setattr(cycles.importlib.util, "find_spec", lambda name: None)
    monkeypatch.setenv("PATH", "")
    monkeypatch.setitem(sys.modules, module, None)
    if name != "cycles":
        monkeypatch.delitem(sys.modules, f"objectfolder.vision.renderers.{name}", raising=False)
    refused(rf"install the extra {extra}", make_renderer, name, Scene(square()))


def test_an_old_llvm_is_refused_before_it_aborts(monkeypatch):
    monkeypatch.setattr(mitsuba, "set_variant", lambda *names: None)
    monkeypatch.setattr("drjit.detail.llvm_version", lambda: (15, 0, 6))
    refused(r"LLVM 15\.0\.6 found.*DRJIT_LIBLLVM_PATH", make_renderer, "mitsuba-llvm", Scene(square()))


def test_mitsubas_camera_is_that_of_camera_rays():
    """Every pixel whose rays all hit or all miss has alpha one or zero."""
    solid = join(box((0.3, 0.2, 0.1), (0.1, 0.25, 0.3)), sphere(0.1, 4, (-0.1, -0.3, -0.2)))
    intrinsics, caster = Intrinsics(60, 44, 70.0), RayCaster(*solid)
    renderer = make_renderer("mitsuba", Scene(painted(solid)))
    for position in ((2.5, 0, 0), (-1.2, 1.7, 1.1), (0, 0, -2.5)):
        pose = look_at(np.array(position))[0]
        alpha = renderer.render(pose, np.ones(3), intrinsics, 16, 1)[..., 3]
        rows, columns = np.mgrid[:44, :60]
        offsets = np.stack(np.meshgrid(*[np.linspace(0, 1, 9)] * 2), -1).reshape(-1, 2)
        pixels = np.stack([columns, rows], -1).reshape(-1, 1, 2) + offsets
        _, face = caster.first_hit(*camera_rays(pose, intrinsics, pixels.reshape(-1, 2)))
        share = (face >= 0).reshape(44, 60, -1).mean(-1)
        assert (share == 1).sum() > 20
        assert (alpha[share == 1] == 1).all()
        assert (alpha[share == 0] == 0).all()
        np.testing.assert_allclose(alpha, share, atol=0.3)
        assert alpha.sum() == pytest.approx(share.sum(), rel=0.02)


def test_the_light_can_be_moved_between_renders():
    renderer = make_renderer("mitsuba", Scene(painted(sphere(0.4, 3))))
    first, moved, back = (renderer.render(FRONT, np.eye(3)[axis], SMALL, 4, 3) for axis in (0, 2, 0))
    np.testing.assert_array_equal(first, back)
    assert np.abs(first - moved).max() > 0.1


def test_a_split_is_the_same_bytes_twice():
    def split():
        rng = np.random.default_rng(3)
        frames = Frames.views(3, Intrinsics.square(16), rng)
        return render_frames(make_renderer("mitsuba", Scene(painted(box((0.5, 0.4, 0.3))))), frames, 4, rng)

    first, second = split(), split()
    assert (first["rgba"].dtype, first["rgba"].shape) == (np.float16, (3, 16, 16, 4))
    assert str(first["renderer"]) == f"mitsuba {mitsuba.__version__} scalar_rgb"
    for name, value in first.items():
        assert value.tobytes() == second[name].tobytes()


@pytest.mark.parametrize("preset", ["quick", *sorted(path.stem for path in (ROOT / "params").glob("*.yaml"))])
def test_mitsuba_takes_the_samples_that_a_preset_says(preset):
    mitsuba.set_variant("scalar_rgb")
    section = read_preset(preset, ROOT)[0]["render_views"]
    for samples in (section["train_samples"], section["test_samples"] // 2):
        sampler = mitsuba.load_dict({"type": "multijitter", "sample_count": samples})
        assert sampler.sample_count() == samples


@pytest.fixture
def blender(tmp_path, monkeypatch):
    """Put a program named blender on the PATH that does what the test says."""

    def put(script):
        program = tmp_path / "blender"
        program.write_text(f"#!{sys.executable}\n{script}")
        program.chmod(program.stat().st_mode | stat.S_IXUSR)
        monkeypatch.setattr(cycles.importlib.util, "find_spec", lambda name: None)
        monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)

    return put


def test_blender_gets_every_view_and_the_scene(blender):
    """A stand-in answers with what it was sent."""
    blender(
        f"import json, sys, numpy as np\nfrom pathlib import Path\n"
        f"assert '--background' in sys.argv and {blender_scene.__file__!r} in sys.argv\n"
        f"folder = Path(sys.argv[-1])\n"
        f"scene = json.loads((folder / 'scene.json').read_text())\n"
        f"mesh = np.load(folder / 'mesh.npz', allow_pickle=False)\n"
        f"print('chatter')\nprint({blender_scene.DONE!r}, '9.9', flush=True)\n"
        f"for line in sys.stdin:\n"
        f"    view = json.loads(line)\n"
        f"    image = np.zeros((view['height'], view['width'], 4), np.float32)\n"
        f"    image[0, 0] = [*view['light'], scene['roughness']]\n"
        f"    image[0, 1] = [len(mesh['faces']), mesh['colors'][0, 0], view['samples'], view['seed']]\n"
        f"    np.save(folder / 'image.npy', image)\n"
        f"    print('chatter')\n    print({blender_scene.DONE!r}, flush=True)\n"
    )
    renderer = make_renderer("cycles", Scene(square(vertex_colors=colors([188, 0, 0]))))
    assert renderer.version == "cycles 9.9 cpu"
    for seed in (5, 2**31 + 6):
        image = renderer.render(FRONT, np.array([1.0, 2, 3]), Intrinsics(5, 4, 4.0), 7, seed)
        assert image.shape == (4, 5, 4)
        assert image[0, 0].tolist() == [1, 2, 3, 1]
        np.testing.assert_allclose(image[0, 1], [2, 0.503, 7, seed % 2**31], atol=2e-3)
    folder, process = renderer._folder, renderer._process
    del renderer
    assert process.poll() == 0
    assert not folder.exists()


@pytest.mark.parametrize("after", ["", f"print({blender_scene.DONE!r}, '9.9', flush=True)\n"])
def test_a_blender_that_fails_is_quoted(blender, after):
    blender(f"import sys\n{after}print('reason one')\nsys.exit('reason two')")
    with pytest.raises(ObjectFolderError, match=r"Blender ended with 1 .*reason one.*reason two"):
        make_renderer("cycles", Scene(square())).render(FRONT, np.ones(3), SMALL, 1, 0)


def test_highlights_beyond_half_precision_are_cut_off():
    glaring = SimpleNamespace(version="none", render=lambda *given: np.full((2, 2, 4), 1e6, np.float32))
    rng = np.random.default_rng(0)
    views = render_frames(glaring, Frames.views(1, Intrinsics.square(2), rng), 1, rng)
    assert np.isfinite(views["rgba"]).all()


@pytest.mark.parametrize(
    ("mesh", "ambient", "message"),
    [
        (TexturedMesh(SQUARE, HALVES[:0]), 0.0, "no faces"),
        (TexturedMesh(np.full((3, 3), np.nan), np.array([[0, 1, 2]])), 0.0, "not finite"),
        (square(), -0.1, "ambient light is -0.1"),
        (square(), float("nan"), "ambient light is nan"),
    ],
)
def test_impossible_scenes_are_refused(mesh, ambient, message):
    refused(message, Scene, mesh, ambient)


@given(st.integers(0, 2**31), st.floats(0.02, 3))
def test_all_that_projects_into_the_image_is_in_the_covered_rectangle(seed, distance):
    rng = np.random.default_rng(seed)
    corners = rng.uniform(-0.5, 0.5, (5, 3))
    pose = look_at(sphere_points(1, distance, rng), rng.uniform(-1, 1, 3))[0]
    intrinsics = Intrinsics(40, 30, 50.0)
    left, top, right, bottom = covered_rectangle(corners, pose, intrinsics)
    assert 0 <= left <= right <= 40
    assert 0 <= top <= bottom <= 30
    inner = rng.dirichlet(np.ones(5), 200) @ corners
    pixels, depth = project(inner, pose, intrinsics)
    seen = (depth > 1e-6) & (pixels >= 0).all(1) & (pixels < [40, 30]).all(1)
    assert (pixels[seen] >= [left, top]).all()
    assert (pixels[seen] <= [right, bottom]).all()


def test_an_object_out_of_sight_covers_nothing():
    away = look_at(np.array([2.5, 0, 0]), (2.5, 3, 0))[0]
    left, top, right, bottom = covered_rectangle(SQUARE + np.array([2.5, 1, 4]), away, SMALL)
    assert (right - left) * (bottom - top) == 0


SCAN = """
import numpy as np
from pathlib import Path
from solids import sphere
from objectfolder.mesh.textured import TexturedMesh
from objectfolder.vision.cameras import Intrinsics, look_at
from objectfolder.vision.renderers.registry import make_renderer
from objectfolder.vision.scene import Scene
v, f = sphere(0.1, 5)
mesh = TexturedMesh(v, f, v[:, :2] + 0.5, np.zeros((1024, 1024, 3), np.uint8))
renderer = make_renderer("mitsuba", Scene(mesh))
renderer.render(look_at(np.array([2.5, 0, 0]))[0], np.ones(3), Intrinsics(), 64, 0)
status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
print(int(status["VmHWM"].split()[0]) / 1024)  # getrusage's begins with the parent's
"""


@pytest.mark.slow
def test_rendering_takes_less_than_a_gigabyte():
    """A scan's mesh and texture at the size and samples of the test views."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "tests/support")])}
    done = subprocess.run(
        [sys.executable, "-c", SCAN], env=environment, capture_output=True, text=True, check=True
    )
    assert 50 < float(done.stdout) < 1000
