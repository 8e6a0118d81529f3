from dataclasses import replace

import numpy as np
import pytest
from refusals import refused

from objectfolder.touch.gel import Layer, deform, indent, respond

MM = 1e-3


def punch(profile, depth=1e-3):
    image = np.full((1, profile.height, profile.width), -1e-3, np.float32)
    image[:, 60:100, 40:80] = depth
    return image


def ball(shape, pitch, radius, depth):
    """Height of a ball over a flat gel, square pixels; pixels that it does not cover are out of reach."""
    z, y = (pitch * (np.arange(n) - (n - 1) / 2) for n in shape)
    square = y**2 + z[:, None] ** 2
    inside = np.sqrt(np.maximum(radius**2 - square, 0))
    return np.where(square < radius**2, depth - radius + inside, -radius).astype(np.float32)


def hertz(layer, radius, depth):
    """Contact radius and force of a paraboloid on a half space."""
    stiffness = layer.young_modulus / (1 - layer.poisson_ratio**2)
    return np.sqrt(radius * depth), 4 / 3 * stiffness * np.sqrt(radius) * depth**1.5


def bonded(layer, radius, depth):
    """Force of a sphere on a bonded layer; Dimitriadis et al. 2002, Biophysical Journal 82, equation 12."""
    nu, chi = layer.poisson_ratio, np.sqrt(radius * depth) / layer.thickness
    a = -(1.2876 - 1.4678 * nu + 1.3442 * nu**2) / (1 - nu)
    b = (0.6387 - 1.0277 * nu + 1.5164 * nu**2) / (1 - nu)
    terms = (
        *(1, -2 * a / np.pi, 4 * a**2 / np.pi**2),
        -8 / np.pi**3 * (a**3 + 4 * np.pi**2 / 15 * b),
        16 * a / np.pi**4 * (a**3 + 3 * np.pi**2 / 5 * b),
    )
    return hertz(layer, radius, depth)[1] * np.polynomial.polynomial.polyval(chi, terms)


def contact(layer, pixels, radius=10 * MM, depth=0.1 * MM):
    """Contact radius and force of a ball, on a grid with so many pixels to Hertz's contact radius."""
    pitch = np.sqrt(radius * depth) / pixels
    side = round(3 * pixels)
    _, pressure = indent(ball((side, side), pitch, radius, depth), pitch, layer)
    return np.sqrt((pressure > 0).sum() * pitch**2 / np.pi), pressure.sum(dtype=float) * pitch**2


# --- compliance


@pytest.mark.parametrize("nu", [0.0, 0.3, 0.48])
def test_short_waves_see_a_half_space_and_long_ones_a_confined_slab(nu):
    layer = Layer(4 * MM, 1.5e5, nu)
    short = np.array([1e4, 1e6])
    np.testing.assert_allclose(layer.compliance(short), 2 * (1 - nu**2) / 1.5e5 / short, rtol=1e-9)
    oedometric = 1.5e5 * (1 - nu) / (1 + nu) / (1 - 2 * nu)
    np.testing.assert_allclose(layer.compliance(np.array([0, 1e-2, 1])), 4 * MM / oedometric, rtol=1e-3)


def test_compliance_is_that_of_the_elastic_equations():
    """Papkovich and Neuber's waves, combined so that they meet the boundary conditions."""
    q, h, nu, modulus = 700.0, 4 * MM, 0.48, 1.5e5
    shear = modulus / 2 / (1 + nu)
    kappa = 3 - 4 * nu

    def displacement(z):
        """Of two solutions each e^(±qz) at depth z, (u, w): u ~ -sin(qx), w ~ cos(qx)."""
        waves = [(sign, np.exp(sign * q * z)) for sign in (1, -1)]
        return np.hstack([[[e, z * e], [sign * e, sign * z * e - kappa / q * e]] for sign, e in waves])

    def stress(z, step=1e-7):
        u, w = displacement(z)
        du, dw = (displacement(z + step) - displacement(z - step)) / 2 / step
        normal = 2 * shear / (1 - 2 * nu) * ((1 - nu) * dw - nu * q * u)
        return np.stack([normal, shear * (du + q * w)])

    # The surface lies at z = 0, unit pressure, no shear; the base at z = h does not move.
    coefficients = np.linalg.solve(np.vstack([stress(0.0), displacement(h)]), [-1, 0, 0, 0])
    found = displacement(0.0)[1] @ coefficients
    assert Layer(h, modulus, nu).compliance(np.array([q]))[0] == pytest.approx(found, rel=1e-5)


# --- a ball


def test_finer_grid_is_nearer_to_hertz():
    layer = Layer(20 * MM, 1.5e5, 0.3)
    exact, _ = hertz(layer, 10 * MM, 0.1 * MM)
    coarse, medium, fine = (abs(contact(layer, pixels)[0] / exact - 1) for pixels in (2.5, 5, 10))
    assert fine < medium < coarse
    assert fine < 0.04


@pytest.mark.parametrize(("ratio", "tolerance"), [(0.05, 0.01), (0.1, 0.015), (0.3, 0.05)])
@pytest.mark.parametrize("nu", [0.3, 0.48])
def test_ball_on_a_bonded_layer_is_dimitriadis(ratio, tolerance, nu):
    """``ratio`` is Hertz's contact radius over the thickness; their series is exact for small ones."""
    layer = Layer(1 * MM / ratio, 1.5e5, nu)
    _, force = contact(layer, 8)
    assert force == pytest.approx(bonded(layer, 10 * MM, 0.1 * MM), rel=tolerance)


def test_thin_compressible_layer_is_a_bed_of_springs():
    layer = Layer(0.02 * MM, 1.5e5, 0.2)
    depth, radius, pitch = 0.01 * MM, 10 * MM, 0.02 * MM
    height = ball((60, 60), pitch, radius, depth)
    displacement, pressure = indent(height, pitch, layer)
    spring = 1.5e5 * 0.8 / 1.2 / 0.6 / layer.thickness
    np.testing.assert_allclose(pressure, spring * height.clip(0), atol=0.06 * spring * depth)
    np.testing.assert_allclose(displacement, height.clip(0), atol=0.06 * depth)
    assert pressure.sum() == pytest.approx(spring * height.clip(0).sum(), rel=0.02)


# --- the conditions of contact


def terrain(profile, seed):
    rng = np.random.default_rng(seed)
    rows, columns = np.mgrid[: profile.height, : profile.width]
    drawn = rng.normal(size=(6, 4)) * [0.4, 0.06, 0.06, 3]
    waves = sum(a * np.cos(p * rows + q * columns + f) for a, p, q, f in drawn)
    return (MM * waves).clip(-0.6 * MM, 3 * MM).astype(np.float32)[None]


@pytest.mark.parametrize("seed", range(4))
def test_no_gap_under_pressure_and_no_pressure_over_a_gap(digit, seed):
    height = terrain(digit, seed)
    displacement, pressure = deform(height, digit)
    reachable = height > -0.6 * MM
    gap = displacement - height
    assert pressure.min() == 0
    assert gap[reachable].min() >= 0
    np.testing.assert_array_equal(gap[pressure > 0], 0)
    assert (pressure[reachable] > 0).mean() > 0.05
    assert (gap[reachable] > 0.01 * MM).mean() > 0.05


def test_surface_is_that_of_the_layer_under_the_pressure(digit):
    """Away from rounding: the displacement is the layer's response to the returned pressure."""
    height = terrain(digit, 1)
    displacement, pressure = deform(height, digit)
    layer = Layer(digit.elastomer_thickness, digit.young_modulus, digit.poisson_ratio)
    # The same periodic cell, here by the definition of the transform's waves.
    rows, columns = 225, 192
    waves = np.hypot(*np.meshgrid(np.fft.fftfreq(rows), np.fft.fftfreq(columns), indexing="ij"))
    spectrum = np.fft.fft2(pressure[0].astype(float), (rows, columns))
    response = np.fft.ifft2(spectrum * layer.compliance(2 * np.pi * waves / digit.pixel_pitch)).real
    error = np.abs(response[: digit.height, : digit.width] - displacement[0])
    assert error.max() < 0.012 * height.max()
    assert np.sqrt((error**2).mean()) < 0.002 * height.max()


def test_edge_of_a_punch_stays_and_the_gel_is_drawn_in_beside_it(flat):
    soft = replace(flat, gel="soft")
    displacement, pressure = deform(punch(soft), soft)
    along = displacement[0, 80]
    np.testing.assert_array_equal(along[40:80], np.float32(1 * MM))
    lowest = along[:41].argmin()
    assert (np.diff(along[lowest:41]) >= 0).all()  # rises towards the contact
    assert 0.2 * MM < along[38] < 0.95 * MM
    assert along[39] < 0.95 * MM
    assert pressure[0, 80, 40] > 2 * pressure[0, 80, 60]  # an edge concentrates the pressure


def test_incompressible_gel_bulges_and_a_cork_like_one_hardly(flat):
    rubber, cork = (replace(flat, gel="soft", poisson_ratio=nu) for nu in (0.49, 0.0))
    lows = [deform(punch(profile), profile)[0].min() for profile in (rubber, cork)]
    assert lows[0] < -0.05 * MM
    assert lows[1] > lows[0] / 4


def test_force_grows_with_depth_and_with_a_thinner_layer(digit):
    thin = replace(digit, elastomer_thickness=0.0031)
    forces = [deform(punch(p, d), p)[1].sum() for p, d in ((digit, 5e-4), (digit, 1e-3), (thin, 1e-3))]
    assert forces[0] < forces[1] < forces[2]
    assert forces[1] == pytest.approx(2 * forces[0], rel=0.1)  # a punch's contact is the same at any depth


def test_rigid_gel_takes_the_imprint_and_nothing_in_reach_leaves_the_gel_alone(digit, flat):
    displacement, pressure = deform(punch(flat), flat)
    np.testing.assert_array_equal(displacement, punch(flat).clip(0))
    assert np.isnan(pressure).all()
    assert not np.any(deform(np.full((2, 160, 120), -1e-3), digit))


def test_small_grids_answer_as_by_transforms(rng, monkeypatch):
    layer, pressure = Layer(0.004, 1.5e5, 0.48), rng.random((20, 15))
    found = respond(pressure, 4e-4, layer)
    monkeypatch.setattr("objectfolder.touch.gel.MAX_DENSE_PIXELS", 0)
    expected = respond(pressure, 4e-4, layer)
    assert found.dtype == expected.dtype == np.float64
    assert abs(found - expected).max() < 1e-6 * expected.max()


@pytest.mark.parametrize("seed", range(3))
def test_solution_is_that_of_a_hundred_times_tighter_tolerance(digit, monkeypatch, seed):
    height = terrain(digit, seed)
    displacement, pressure = deform(height, digit)
    monkeypatch.setattr("objectfolder.touch.gel.CONTACT_TOLERANCE", 1e-4)
    exact, exact_pressure = deform(height, digit)
    assert pressure.sum(dtype=float) == pytest.approx(exact_pressure.sum(dtype=float), rel=5e-3)
    assert np.abs(displacement - exact).max() < 0.01 * height.max()


def test_needle_that_coarse_grids_do_not_see_is_felt(digit):
    height = np.full((1, digit.height, digit.width), -0.6 * MM, np.float32)
    height[0, 70, 50] = 1 * MM
    displacement, pressure = deform(height, digit)
    assert np.flatnonzero(pressure[0]) == [70 * digit.width + 50]
    assert displacement[0, 70, 50] == np.float32(1 * MM)
    # The layer's own response to a load on one pixel.
    layer = Layer(digit.elastomer_thickness, digit.young_modulus, digit.poisson_ratio)
    pitch = digit.pixel_pitch
    waves = 2 * np.pi * np.hypot(*np.meshgrid(*[np.fft.fftfreq(1024, pitch)] * 2))
    assert pressure.max() * layer.compliance(waves).mean() == pytest.approx(1 * MM, rel=0.02)


def test_unreachable_pixels_are_never_pressed(digit, monkeypatch):
    """Beside a post the gel bulges past the height that stands for out of reach."""
    monkeypatch.setattr("objectfolder.touch.gel.GAP", 1e-6)
    height = np.full((1, digit.height, digit.width), -1e-6 * digit.elastomer_thickness, np.float32)
    height[0, 60:100, 40:80] = 2 * MM
    displacement, pressure = deform(height, digit)
    outside = height[0] < 0
    assert displacement[0][outside].min() < -0.1 * MM
    assert not pressure[0][outside].any()


def test_the_gel_does_not_pass_through_the_lowest_part_of_what_it_touches(digit):
    """Below a step of 1.02 mm that is pressed in by 1 mm, the gel bulges against the lower half."""
    height = np.full((1, digit.height, digit.width), -0.02 * MM, np.float32)
    height[:, :, :60] = 1 * MM
    displacement, pressure = deform(height, digit)
    assert (displacement >= height).all()
    below = np.s_[0, 20:-20, 70:-20]
    assert (pressure[below] > 0).any()
    deeper = height.copy()
    deeper[0, 0, -1] = -0.05 * MM  # one pixel lies lower still: it alone may change
    felt = deform(deeper, digit)[1]
    assert felt.sum() == pytest.approx(pressure.sum(), rel=1e-3)


def test_gel_that_does_not_converge_says_so(digit, monkeypatch):
    monkeypatch.setattr("objectfolder.touch.gel._MAX_STEPS", 1)
    refused("did not converge", deform, terrain(digit, 0), digit)
