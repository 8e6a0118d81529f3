from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
import torch
from solids import box, join, sphere

from objectfolder.mesh.raycast import RayCaster
from objectfolder.mesh.textured import TexturedMesh
from objectfolder.vision.bsdf import principled
from objectfolder.vision.cameras import Intrinsics, camera_rays, look_at
from objectfolder.vision.renderers.mitsuba import MitsubaRenderer
from objectfolder.vision.scene import Scene
from objectfolder.vision.truth import Frames, render_frames
from objectfolder.workspace.presets import read_preset

REPOSITORY = Path(__file__).parents[2]
FRONT = look_at(np.array([2.5, 0, 0]))[0]
SMALL = Intrinsics.square(64)


def painted(solid, color=(255, 255, 255), **material):
    colors = np.tile(np.uint8(color), (len(solid[0]), 1))
    return TexturedMesh(*solid, vertex_colors=colors, **material)


def quad(texture=None, **material):
    """A square in the plane x = 0 that faces +x; its texture's bottom is at z = -0.5, left at y = -0.5."""
    vertices = np.array([[0, -0.5, -0.5], [0, 0.5, -0.5], [0, 0.5, 0.5], [0, -0.5, 0.5]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    uv = vertices[:, 1:] + 0.5
    if texture is None:
        return painted((vertices, faces), **material)
    return TexturedMesh(vertices, faces, uv, texture, **material)


def radiance(mesh, light, samples=16, pose=FRONT, intrinsics=SMALL):
    return MitsubaRenderer(Scene(mesh)).render(pose, np.asarray(light, float), intrinsics, samples, 1)


def test_a_rough_white_surface_facing_the_light_at_distance_one_has_radiance_one():
    """Exact for a Lambertian; the principled BSDF adds its highlight and retroreflection."""
    image = radiance(quad(roughness=1.0), [1, 0, 0], pose=look_at(np.array([1.5, 2.0, 0]))[0], samples=256)
    assert image[32, 32, 3] == 1
    front, view = torch.tensor([[1.0, 0, 0]]), torch.tensor([[-0.6, -0.8, 0]])
    expected = principled(front, view, front, torch.ones(1, 3), 1.0, 0.0)[0]
    np.testing.assert_allclose(image[32, 32, :3], expected, rtol=0.01)
    np.testing.assert_allclose(expected, 1, atol=0.03)


def test_vertex_colours_equal_a_texture_of_that_colour():
    color = (200, 120, 40)
    texture = np.full((4, 4, 3), color, np.uint8)
    a = radiance(quad(texture), [1.5, 0.2, 0])
    vertices = quad()
    b = radiance(painted((vertices.vertices, vertices.faces), color), [1.5, 0.2, 0])
    np.testing.assert_allclose(a[20:44, 20:44], b[20:44, 20:44], rtol=5e-3)


def test_the_camera_is_that_of_camera_rays():
    """Every pixel whose rays all hit or all miss has alpha one or zero."""
    solid = join(box((0.3, 0.2, 0.1), (0.1, 0.25, 0.3)), sphere(0.1, 4, (-0.1, -0.3, -0.2)))
    intrinsics = Intrinsics(60, 44, 70.0)
    caster = RayCaster(*solid)
    for position in ((2.5, 0, 0), (-1.2, 1.7, 1.1), (0, 0, -2.5)):
        pose = look_at(np.array(position))[0]
        alpha = radiance(painted(solid), [1, 1, 1], 16, pose, intrinsics)[..., 3]
        rows, columns = np.mgrid[:44, :60]
        axis = np.linspace(0, 1, 9)
        offsets = np.stack(np.meshgrid(axis, axis), -1).reshape(-1, 2)
        pixels = np.stack([columns, rows], -1).reshape(-1, 1, 2) + offsets
        _, face = caster.first_hit(*camera_rays(pose, intrinsics, pixels.reshape(-1, 2)))
        share = (face >= 0).reshape(44, 60, -1).mean(-1)
        assert (share == 1).sum() > 20
        assert (alpha[share == 1] == 1).all()
        assert (alpha[share == 0] == 0).all()
        np.testing.assert_allclose(alpha, share, atol=0.3)
        assert alpha.sum() == pytest.approx(share.sum(), rel=0.02)


def test_the_light_can_be_moved_between_renders():
    renderer = MitsubaRenderer(Scene(painted(sphere(0.4, 3))))
    lights = np.array([[1.0, 0, 0], [0, 0, 1.0], [1.0, 0, 0]])
    images = [renderer.render(FRONT, light, SMALL, 4, 3) for light in lights]
    np.testing.assert_array_equal(images[0], images[2])
    assert np.abs(images[0] - images[1]).max() > 0.1


def test_unit_alpha_background_and_finite():
    image = radiance(painted(sphere(0.3, 3), metallic=1.0, roughness=0.0), [1, 1, 1])
    assert np.isfinite(image).all()
    assert (image[:5] == 0).all()


def test_a_split_is_the_same_bytes_twice():
    def split():
        renderer = MitsubaRenderer(Scene(painted(box((0.5, 0.4, 0.3)))))
        rng = np.random.default_rng(3)
        return render_frames(renderer, Frames.views(3, Intrinsics.square(16), rng), 4, rng)

    first, second = split(), split()
    assert (first["rgba"].dtype, first["rgba"].shape) == (np.float16, (3, 16, 16, 4))
    for name, value in first.items():
        assert value.tobytes() == second[name].tobytes()


@pytest.mark.parametrize("preset", ["quick", *sorted(p.stem for p in (REPOSITORY / "params").glob("*.yaml"))])
def test_mitsuba_takes_the_samples_that_a_preset_says(preset):
    mi.set_variant("scalar_rgb")
    section = read_preset(preset, REPOSITORY)[0]["render_views"]
    for samples in (section["train_samples"], section["test_samples"] // 2):
        sampler = mi.load_dict({"type": "multijitter", "sample_count": samples})
        assert sampler.sample_count() == samples
