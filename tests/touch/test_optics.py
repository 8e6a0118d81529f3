import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from PIL import Image
from refusals import refused

from objectfolder.touch.arrays import blur
from objectfolder.touch.camera import gel_depth, ray_directions
from objectfolder.touch.optics import Optics
from objectfolder.touch.profiles import available_profiles, load_profile
from objectfolder.touch.shading import shade


def bump(profile, row=80, column=60, height=1e-3, width=6.0):
    rows = torch.arange(profile.height)[:, None] - row
    columns = torch.arange(profile.width) - column
    return height * torch.exp(-(rows**2 + columns**2) / (2 * width**2))[None]


def test_background_is_smooth_and_reproducible(digit, optics):
    assert torch.equal(Optics(digit).background, optics.background)
    values = optics.background.int()
    assert values.diff(dim=0).abs().max() <= 3
    assert values.diff(dim=1).abs().max() <= 3
    assert 60 < values.float().mean() < 160


def test_background_glows_where_the_lights_are(digit, optics):
    for light in digit.lights:
        channel = light.color.index(1)
        brightest = int(optics.background[..., channel].argmax())
        row, column = divmod(brightest, digit.width)
        if light.position[1]:
            assert (column < digit.width / 2) == (light.position[1] > 0)
        assert (row < digit.height / 2) == (light.position[2] > 0)


def test_slope_towards_a_light_is_brighter(digit, optics):
    image = optics.render(bump(digit))[0].int() - optics.background.int()
    # Blue lies below. The gel bulges towards the camera, so its lower flank faces the light.
    assert image[88, 60, 2] > 15
    assert image[72, 60, 2] < -15
    # Red lies on the left, green on the right.
    assert image[80, 52, 0] > 10 > -10 > image[80, 68, 0]
    assert image[80, 68, 1] > 10 > -10 > image[80, 52, 1]


def test_noise_is_the_generators(digit, optics):
    noisy = Optics(replace(digit, noise_std=4.0))
    images = optics.background.expand(3, -1, -1, -1)

    def draw(seed):
        return noisy.noise(images, torch.Generator().manual_seed(seed))

    assert torch.equal(draw(1), draw(1))
    assert not torch.equal(draw(1), draw(2))
    assert abs((draw(1).float() - images.float()).std() - 4.0) < 0.2
    assert optics.noise(images, torch.Generator()) is images


def textbook(point, normal, light, profile):
    """glTF 2.0, appendix B, for one point and one light, with the bounds of pyrender's cosines."""
    view, towards = -point / np.linalg.norm(point), np.array(light.position) - point
    distance = np.linalg.norm(towards)
    towards = towards / distance
    half = (view + towards) / np.linalg.norm(view + towards)
    nl, nv = np.clip(normal @ towards, 0.001, 1), np.clip(abs(normal @ view), 0.001, 1)
    nh, vh = np.clip(normal @ half, 0, 1), np.clip(view @ half, 0, 1)
    f0 = 0.04 * (1 - profile.metallic) + profile.albedo * profile.metallic
    fresnel = f0 + (1 - f0) * (1 - vh) ** 5
    k, alpha2 = (profile.roughness + 1) ** 2 / 8, profile.roughness**4
    shadowing = nl / (nl * (1 - k) + k) * nv / (nv * (1 - k) + k)
    spread = alpha2 / (math.pi * (nh**2 * (alpha2 - 1) + 1) ** 2)
    diffuse = (1 - fresnel) * profile.albedo * 0.96 * (1 - profile.metallic) / math.pi
    reflected = nl * (diffuse + fresnel * shadowing * spread / (4 * nl * nv + 0.001))
    return reflected * light.intensity / distance**2 * np.array(light.color)


@pytest.mark.parametrize("name", available_profiles())
def test_no_untouched_gel_is_too_bright_to_show_a_difference(name):
    assert Optics(load_profile(name)).untouched.max() < 0.96


@pytest.mark.parametrize("name", ["tacto_digit", "digit_realistic"])
def test_shading_is_the_textbooks(name):
    profile = load_profile(name)
    rng = np.random.default_rng(0)
    points = rng.uniform((0.015, -0.01, -0.01), (0.024, 0.01, 0.01), (200, 3))
    normals = rng.normal(size=(200, 3))
    normals[:, 0] = -np.abs(normals[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    lit = [sum(textbook(p, n, light, profile) for light in profile.lights) for p, n in zip(points, normals)]
    expected = np.clip(profile.ambient + np.array(lit), 0, 1).T ** (1 / 2.2)
    columns = (tuple(torch.from_numpy(v.T.astype(np.float32)).contiguous()) for v in (points, normals))
    assert np.abs(shade(*columns, profile).numpy() - expected).max() < 2e-4


def test_inclined_plane_is_shaded_with_its_own_normal(digit):
    """A plane before the flat gel: every pixel's normal is the plane's, up to the image's border."""
    profile = replace(digit, gel_curvature=0.0, image_smoothing=0.0)
    optics, rays = Optics(profile), ray_directions(profile)
    normal = np.array([-1, 0.15, -0.1]) / np.linalg.norm([1, 0.15, 0.1])
    depth = (normal @ (0.018, 0, 0)) / (rays @ normal)
    moved = torch.from_numpy(gel_depth(profile) - depth).float()[None]
    assert moved.min() > 0

    def shaded(depth, normal):
        points = torch.from_numpy(rays * np.broadcast_to(depth, rays.shape[:2])[..., None]).float().unbind(-1)
        return shade(points, tuple(torch.full_like(points[0], n) for n in normal), profile)

    expected = 255 * profile.gain * (shaded(depth, normal) - shaded(gel_depth(profile), (-1.0, 0.0, 0.0)))
    inside = np.s_[:, 5:-5, 5:-5]  # at the border, differences are one-sided
    assert (optics.change(moved)[0] - expected)[inside].abs().max() < 0.3


def test_slopes_are_not_mixed_across_the_rim(digit):
    """Whatever lies beyond the rim, the flat top of an imprint shows a flat surface up to it."""
    profile = replace(digit, gel_curvature=0.0, image_smoothing=0.0, slope_smoothing=0.0005)
    optics = Optics(profile)
    # A plateau parallel to the gel: constant depth, so no slope along the image.
    plateau = torch.zeros(1, 160, 120)
    plateau[:, 40:120, 30:90] = 1e-3
    whole = optics.change(torch.full((1, 160, 120), 1e-3))
    assert torch.equal(optics.change(plateau)[..., 40:120, 30:90], whole[..., 40:120, 30:90])
    assert optics.change(plateau)[0, :, :40].abs().max() == 0


def test_batch_has_the_bits_of_single_images(digit, optics):
    rng = np.random.default_rng(0)
    moved = torch.cat([bump(digit, *rng.uniform(30, 90, 2), width=w) for w in (3.0, 6.0, 11.0, 20.0)])
    moved[1] += 1e-5  # a soft gel moves everywhere, and bulges
    moved[2] -= 1e-5
    moved[3, :, :40] = 0
    together = optics.render(moved)
    assert all(torch.equal(together[i], optics.render(moved[i : i + 1])[0]) for i in range(4))
    assert torch.equal(optics.render(moved.flip(0)), together.flip(0))


@pytest.mark.parametrize("name", ["digit", "tacto_digit"])
def test_tensors_and_arrays_give_the_same_image(name, monkeypatch):
    """On other devices than the CPU the optics compute with tensors."""
    profile = load_profile(name)
    rng = np.random.default_rng(0)
    moved = torch.cat([bump(profile, *rng.uniform(30, 90, 2), width=w) for w in (3.0, 6.0, 20.0)])
    moved[1] -= 1e-5
    moved[2, :, :40] = 0
    change = Optics(profile).change(moved)
    monkeypatch.setattr(Optics, "_array", lambda self, values: values.float())
    tensors = Optics(profile)
    assert isinstance(tensors._maps, torch.Tensor)
    assert change.abs().max() > 20
    torch.testing.assert_close(tensors.change(moved), change, rtol=0, atol=1e-3)
    difference = tensors.render(moved).int() - Optics(profile).background.int()
    assert (difference - change.permute(0, 2, 3, 1)).abs().max() <= 0.501


def test_image_is_that_of_its_own_window_alone(digit, optics):
    """What is computed within the bounds of the contact is what the whole image has."""
    moved = bump(digit, 80, 60, width=4.0)
    moved[moved < 1e-6] = 0
    touched = np.argwhere(moved[0].numpy())
    assert touched.min(axis=0).min() > 10
    # A change far from the contact makes the window the whole image.
    far = moved.clone()
    far[0, [0, -1]] = far[0, :, [0, -1]] = 1e-4
    near = np.s_[:, :, 15:-15, 15:-15]
    torch.testing.assert_close(optics.change(far)[near], optics.change(moved)[near], rtol=0, atol=1e-4)


def test_blur_keeps_constants_and_has_its_variance():
    ones = torch.ones(1, 1, 20, 30)
    assert (blur(ones, 1.4) - 1).abs().max() < 1e-6
    point = torch.zeros(1, 1, 41, 41)
    point[..., 20, 20] = 1
    spread = blur(point, 4.0)[0, 0]
    assert spread.sum() == pytest.approx(1, rel=1e-5)
    variance = (spread.sum(dim=0) * (torch.arange(41) - 20.0) ** 2).sum()
    assert 0.7 * 16 < variance < 16  # cut off at two deviations


def test_background_is_the_profiles_picture(digit, tmp_path):
    rng = np.random.default_rng(0)
    small = rng.integers(0, 256, (160, 120, 3), np.uint8)
    Image.fromarray(small.repeat(2, 0).repeat(2, 1)).save(tmp_path / "rest.png")
    optics = Optics(replace(digit, background_image=str(tmp_path / "rest.png")))
    assert np.array_equal(optics.background.numpy(), small)
    assert torch.equal(optics.render(torch.zeros(1, 160, 120))[0], optics.background)


def test_background_picture_that_cannot_be_used_is_named(digit, tmp_path):
    path = tmp_path / "rest.png"
    for write, reason in (
        (lambda: None, "does not exist"),
        (lambda: path.write_bytes(b""), "cannot be read"),
        (lambda: path.write_bytes(b"\x89PNG\r\n"), "cannot be read"),
        (lambda: Image.new("RGB", (160, 120)).save(path), r"160 x 120 pixels.* 0\.750"),
    ):
        write()
        refused(rf"rest\.png.*{reason}", Optics, replace(digit, background_image=str(path)))
