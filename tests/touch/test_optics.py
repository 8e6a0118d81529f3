from dataclasses import replace

import torch

from objectfolder.touch.optics import Optics


def bump(profile, row=80, column=60, height=1e-3, width=6.0):
    rows = torch.arange(profile.height)[:, None] - row
    columns = torch.arange(profile.width) - column
    return height * torch.exp(-(rows**2 + columns**2) / (2 * width**2))[None]


def test_untouched_gel_shows_the_background(digit, optics):
    still = torch.zeros(2, digit.height, digit.width)
    assert torch.equal(optics.render(still), optics.background.expand(2, -1, -1, -1))


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


def test_image_changes_around_the_contact_only(digit, optics):
    change = (optics.render(bump(digit, 100, 40))[0].int() - optics.background.int()).abs().amax(dim=2)
    rows, columns = torch.nonzero(change > 1, as_tuple=True)
    distance = torch.hypot(rows - 100.0, columns - 40.0)
    assert distance.max() < 4.5 * 6
    assert change.max() > 20


def test_noise_is_the_generators(digit, optics):
    noisy = Optics(replace(digit, noise_std=4.0))
    images = optics.background.expand(3, -1, -1, -1)

    def draw(seed):
        return noisy.noise(images, torch.Generator().manual_seed(seed))

    assert torch.equal(draw(1), draw(1))
    assert not torch.equal(draw(1), draw(2))
    assert abs((draw(1).float() - images.float()).std() - 4.0) < 0.2
    assert optics.noise(images, torch.Generator()) is images
