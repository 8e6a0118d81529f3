import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from refusals import refused

from objectfolder.base.metrics import psnr
from objectfolder.mesh.closing.surface import close_surface
from objectfolder.mesh.raycast import RayCaster
from objectfolder.mesh.reading.load import load_mesh
from objectfolder.touch.contact import heightmaps
from objectfolder.touch.optics import Optics
from objectfolder.touch.profiles import load_profile
from objectfolder.touch.tacto import NOISE_STD, TactoReference, gel_triangles
from objectfolder.touch.tacto_rays import TactoRays, smooth_normals

MUG = Path(__file__).parents[3] / "shared" / "objects" / "ycb_mug" / "mesh.obj"
PYRENDER = pytest.mark.skipif(
    importlib.util.find_spec("pyrender") is None, reason="pyrender is not installed"
)


@pytest.fixture(scope="module")
def tacto():
    return load_profile("tacto_digit")


@pytest.fixture(scope="module")
def bumpy():
    """A smooth lump of about 30 mm, finely meshed, in metres."""
    mesh = trimesh.creation.icosphere(5)
    x, y, z = mesh.vertices.T
    radius = 0.012 + 0.001 * np.sin(5 * x) * np.cos(4 * y) + 0.001 * np.sin(3 * z)
    return np.asarray(mesh.vertices * radius[:, None]), np.asarray(mesh.faces)


@pytest.fixture(scope="module")
def contacts(bumpy):
    return on_surface(*bumpy, 4)


def on_surface(vertices, faces, count):
    """Points, normals, angles and depths."""
    rng = np.random.default_rng(0)
    normals = smooth_normals(vertices, faces)
    chosen = rng.choice(len(vertices), count, replace=False)
    angles, depths = rng.uniform(0, 2 * np.pi, count), rng.uniform(5e-4, 2e-3, count)
    return vertices[chosen], normals[chosen], angles, depths


def decibel(image, truth, where=None):
    error = ((image.astype(float) - truth) / 255) ** 2
    return psnr(np.mean(error if where is None else error[where]))


def test_object_out_of_reach_leaves_the_background(tacto, bumpy):
    fast = TactoRays(*bumpy, tacto)
    images, contact = fast.render(np.array([[0.0, 0, 0.03]]), np.array([[0.0, 0, 1]]), [0.0], [0.001])
    assert np.array_equal(images[0], fast.background)
    assert not contact.any()


def test_batch_has_the_bits_of_single_images(tacto, bumpy, contacts):
    fast = TactoRays(*bumpy, tacto)
    whole = fast.render(*contacts)
    for i in range(len(whole[0])):
        for alone, together in zip(fast.render(*(c[i : i + 1] for c in contacts)), whole):
            assert np.array_equal(alone[0], together[i])


def test_contact_is_where_the_heightmap_has_it_and_smooth_objects_look_the_same(tacto, bumpy, contacts):
    images, contact = TactoRays(*bumpy, tacto).render(*contacts)
    height = heightmaps(RayCaster(*bumpy), *contacts, tacto)[0]
    assert np.mean(contact != (height > 0)) < 1e-3
    other = Optics(tacto).render(torch.from_numpy(np.maximum(height, 0))).numpy()
    assert decibel(other, images) > 44
    assert decibel(other, images, contact) > 41


def test_what_blocks_the_sensor_is_seen(tacto):
    """A post beside the contact reaches behind the gel: TACTO draws it, nearer than the deepest imprint."""
    plate = trimesh.creation.box((0.03, 0.03, 0.002))
    plate.apply_translation((0, 0, -0.001))
    post = trimesh.creation.box((0.002, 0.002, 0.014))
    post.apply_translation((0.004, 0, 0.006))
    mesh = trimesh.util.concatenate([plate, post])
    fast = TactoRays(mesh.vertices, mesh.faces, tacto)
    contact = np.array([[0.0, 0, 0]]), np.array([[0.0, 0, 1]]), [0.0], [0.0]
    _, seen = fast.render(*contact)
    _, without = TactoRays(plate.vertices, plate.faces, tacto).render(*contact)
    assert seen.sum() > without.sum() + 100


def test_scale_is_metres_per_unit(tacto, bumpy, contacts):
    vertices, faces = bumpy
    images, _ = TactoRays(vertices, faces, tacto).render(*contacts)
    scaled, _ = TactoRays(vertices / 0.024, faces, tacto, 0.024).render(*contacts)
    assert decibel(scaled, images) > 60


def test_gel_of_the_reference_lies_on_the_profiles_dome(tacto):
    triangles = gel_triangles(tacto)
    y, z = triangles[..., 1], triangles[..., 2]
    sag = 0.1 * tacto.gel_curvature * (0.1 - np.sqrt(0.01 - y**2 - z**2))
    assert np.abs(triangles[..., 0] - (0.022 - sag)).max() < 1e-9
    front = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    assert (np.einsum("ij,ij->i", front, triangles.mean(axis=1)) < 0).all()
    assert y.max() > 0.0095
    assert z.max() > 0.0127


def test_without_pyrender_the_reference_says_what_to_install(tacto, bumpy, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyrender", None)
    monkeypatch.delitem(sys.modules, "objectfolder.vision.renderers.raster", raising=False)
    refused(r"install the extra raster .*libegl1", TactoReference, *bumpy, tacto)


@PYRENDER
def test_reference_refuses_what_its_shader_cannot_draw(bumpy):
    refused(r"'digit_realistic'.*ambient = 0\.04", TactoReference, *bumpy, load_profile("digit_realistic"))


@PYRENDER
def test_fast_path_draws_what_the_reference_draws(tacto, bumpy, contacts):
    truth, contact = TactoReference(*bumpy, tacto).render(*contacts)
    images, touched = TactoRays(*bumpy, tacto).render(*contacts)
    assert decibel(images, truth) > 55
    assert decibel(images, truth, contact) > 52
    assert np.mean(contact != touched) < 0.01


@PYRENDER
def test_fast_path_draws_a_scanned_object_like_the_reference(tacto):
    if not MUG.exists():
        pytest.skip("no shared objects here")
    mesh = load_mesh(MUG, "z", 64)
    surface = close_surface(mesh.vertices, mesh.faces)
    contacts = on_surface(surface.vertices, surface.faces, 6)
    truth, contact = TactoReference(surface.vertices, surface.faces, tacto).render(*contacts)
    images, _ = TactoRays(surface.vertices, surface.faces, tacto).render(*contacts)
    assert decibel(images, truth) > 55
    assert decibel(images, truth, contact) > 52


@PYRENDER
def test_reference_repeats_itself_and_its_noise_is_seeded(tacto, bumpy, contacts):
    reference = TactoReference(*bumpy, tacto)

    def draw(seed=None):
        noise = None if seed is None else np.random.default_rng(seed)
        return reference.render(*contacts, noise)[0]

    clean = draw()
    assert np.array_equal(clean, draw())
    assert np.array_equal(draw(1), draw(1))
    assert not np.array_equal(draw(1), draw(2))
    assert np.std(draw(1).astype(float) - clean) == pytest.approx(NOISE_STD, rel=0.02)
