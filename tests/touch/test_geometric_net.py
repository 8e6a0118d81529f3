import dataclasses
import gc
import weakref
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import trimesh
from PIL import Image
from refusals import refused
from solids import sphere

from objectfolder.base.metrics import psnr
from objectfolder.mesh.grid import DistanceGrid
from objectfolder.mesh.isosurface import Isosurface
from objectfolder.mesh.sampling import sample_surface
from objectfolder.mesh.sdf import distance_grid
from objectfolder.touch import gel
from objectfolder.touch.geometric_net import GeometricTouch
from objectfolder.touch.geometric_training import fit_contacts
from objectfolder.touch.profiles import load_profile
from objectfolder.touch.tacto_rays import TactoRays
from objectfolder.touch.truth import render_contacts

SCALE = 0.06
BALL = sphere(0.4, 5)


@pytest.fixture(scope="module")
def surface():
    return Isosurface(DistanceGrid(*distance_grid(*BALL, 96)))


@pytest.fixture(scope="module")
def points():
    return sample_surface(*BALL, 6, np.random.default_rng(0))


def contacts(points, profile, **options):
    return render_contacts(*BALL, SCALE, points, profile, np.random.default_rng(1), **options)


def answer(net, contacts):
    places = contacts["points"]
    return net.images(places, net.normals(places), contacts["angles"], contacts["depths"])


def decibel(images, truth):
    return psnr(np.mean((images / 255.0 - truth / 255.0) ** 2))


def test_stored_geometry_answers_contacts_it_has_not_seen(surface, points):
    """The truth of renderer tacto is TACTO's."""
    for sensor, renderer, expected in (("digit", "gel", 50), ("tacto_digit", "tacto", 45)):
        profile = load_profile(sensor)
        truth = contacts(points, profile, renderer=renderer)
        net = GeometricTouch(surface, SCALE, profile, renderer=renderer)
        assert decibel(answer(net, truth), truth["images"]) > expected
    pose = (truth[name] for name in ("points", "normals", "angles", "depths"))
    np.testing.assert_array_equal(truth["images"], TactoRays(*BALL, profile, SCALE).render(*pose)[0])
    assert np.isnan(truth["force"]).all()
    assert (truth["masks"].sum((1, 2)) > 50).all()


def test_normals_of_a_ball_are_radial(surface, points):
    net = GeometricTouch(surface, SCALE, load_profile("digit"))
    radial = points / np.linalg.norm(points, axis=1, keepdims=True)
    assert np.degrees(np.arccos((net.normals(points * SCALE) * radial).sum(1).clip(-1, 1))).max() < 0.3


def test_the_offset_of_deeper_presses_is_found(surface, points):
    profile = load_profile("digit")
    deeper = contacts(points, profile)
    deeper["depths"] = deeper["depths"] - 1e-4  # what is said, not what was done
    net = GeometricTouch(surface, SCALE, profile)
    curve = fit_contacts(net, deeper, {k: v[:1] for k, v in deeper.items()}, 2e-4, 4)
    assert net.depth_offset == pytest.approx(1e-4, abs=1.5e-5)
    assert curve[-1].train_loss <= curve[0].train_loss


def test_a_background_picture_travels_in_the_tensors(surface, points, tmp_path):
    grey = np.full((160, 120, 3), 77, np.uint8)
    Image.fromarray(grey).save(tmp_path / "rest.png")
    profile = dataclasses.replace(load_profile("digit"), background_image=str(tmp_path / "rest.png"))
    net = GeometricTouch(surface, SCALE, profile)
    tensors, config = net.to_tensors()
    truth = answer(net, contacts(points, profile))
    (tmp_path / "rest.png").unlink()
    back = GeometricTouch.from_tensors(surface, SCALE, tensors, config)
    np.testing.assert_array_equal(answer(back, contacts(points, load_profile("digit"))), truth)
    assert truth[0, 0, 0].tolist() == [77, 77, 77]
    assert str(tmp_path) not in str(config)
    with pytest.raises(ValueError, match="background of shape"):
        GeometricTouch.from_tensors(surface, SCALE, {"background": grey[:5]}, config)


def test_a_stored_background_stays_with_the_stored_profile(surface, points):
    profile = load_profile("digit_real")
    back = GeometricTouch.from_tensors(surface, SCALE, *GeometricTouch(surface, SCALE, profile).to_tensors())
    again = back.with_sensor(back.profile)
    made = contacts(points, profile)
    np.testing.assert_array_equal(answer(again, made), answer(back, made))
    np.testing.assert_array_equal(again.background, back.background)
    other = back.with_sensor(load_profile("digit"))
    assert (other.background != back.background).any()


def test_the_renderer_of_the_stored_sensor_is_stored(surface):
    net = GeometricTouch(surface, SCALE, load_profile("tacto_digit"), 1e-5, "tacto")
    net.smooth(2)
    back = GeometricTouch.from_tensors(surface, SCALE, *net.to_tensors())
    assert (back.renderer, back.depth_offset, back.smoothing) == ("tacto", 1e-5, 2)
    other = back.with_sensor(load_profile("digit"))
    assert (other.renderer, other.depth_offset, other.profile.name) == ("gel", 1e-5, "digit")


@pytest.mark.parametrize(
    ("renderer", "message"), [("tacto", "rigid gel.*'digit' is soft"), ("x", "renderer is 'x'")]
)
def test_a_renderer_that_does_not_fit_is_refused(surface, points, renderer, message):
    for build in (
        lambda: GeometricTouch(surface, SCALE, load_profile("digit"), renderer=renderer),
        lambda: contacts(points, load_profile("digit"), renderer=renderer),
    ):
        refused(message, build)


def test_depth_and_angle_of_all_contacts_can_be_chosen(points):
    truth = contacts(points, load_profile("digit"), depth=0.0012, angle=0.7)
    assert set(truth["depths"]) == {0.0012}
    assert set(truth["angles"]) == {0.7}
    np.testing.assert_allclose(truth["max_penetration"], 0.0012, atol=2e-5)
    free = contacts(points, load_profile("digit"))
    assert np.ptp(free["depths"]) > 0
    assert np.ptp(free["angles"]) > 1


def test_normals_are_smoothed_as_the_triangles_of_the_truth_do():
    """TACTO draws a coarse box with interpolated normals; the stored surface has sharp edges."""
    coarse = trimesh.creation.box((0.7, 0.7, 0.7)).subdivide().subdivide().subdivide()
    mesh = np.asarray(coarse.vertices), np.asarray(coarse.faces)
    stored = Isosurface(DistanceGrid(*distance_grid(*mesh, 96)))
    profile = load_profile("tacto_digit")
    places = sample_surface(*mesh, 8, np.random.default_rng(0))
    truth = render_contacts(*mesh, SCALE, places, profile, np.random.default_rng(1), "tacto")
    net = GeometricTouch(stored, SCALE, profile, renderer="tacto")
    before = decibel(answer(net, truth), truth["images"])
    curve = fit_contacts(net, truth, {k: v[:2] for k, v in truth.items()}, 2e-4, 2)
    assert net.smoothing > 0
    found = answer(net, truth)
    assert decibel(found, truth["images"]) > before + 1
    assert curve[-1].train_loss == pytest.approx(np.mean((found / 255.0 - truth["images"] / 255.0) ** 2))


def test_device_draws_the_images_only(surface, points):
    """No test machine has a GPU: the tensors of `meta` have no values, and refuse to become an image."""
    profile = load_profile("digit")
    net = GeometricTouch(surface, SCALE, profile, device="meta")
    assert net.with_sensor(load_profile("tacto_digit"))._optics.device.type == "meta"
    tensors, config = net.to_tensors()
    assert GeometricTouch.from_tensors(surface, SCALE, tensors, config, "meta")._optics.device.type == "meta"
    with pytest.raises(NotImplementedError, match="meta"):
        answer(net, contacts(points[:1], profile))


def test_threads_share_the_nets_of_other_sensors(surface):
    net = GeometricTouch(surface, SCALE, load_profile("digit"))
    with ThreadPoolExecutor(4) as pool:
        others = list(pool.map(net.with_sensor, [load_profile("tacto_digit")] * 8))
    assert all(other is others[0] for other in others)


def test_any_number_of_sensors_takes_bounded_memory(surface):
    """As when somebody varies a sensor at random."""
    net, profile = GeometricTouch(surface, SCALE, load_profile("digit")), load_profile("digit")
    varied = [dataclasses.replace(profile, young_modulus=1e5 + i) for i in range(40)]
    others = []
    for one in varied:
        other = net.with_sensor(one)
        next(other.touches(*[np.array([[0.4 * SCALE, 0, 0]]), np.eye(3)[:1], *np.zeros((2, 1))]))
        others.append(weakref.ref(other))
        del other
    gc.collect()
    assert 0 < sum(other() is not None for other in others) < 10
    assert gel._compliance.cache_info().currsize < 40
    assert net.with_sensor(varied[-1]) is net.with_sensor(varied[-1])
