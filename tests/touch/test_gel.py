from dataclasses import replace

import torch

from objectfolder.touch.gel import deform


def punch(profile, depth=1e-3):
    image = torch.zeros(1, profile.height, profile.width)
    image[:, 60:100, 40:80] = depth
    return image


def test_rigid_gel_takes_the_imprint(flat):
    assert torch.equal(deform(punch(flat), flat), punch(flat))


def test_gel_stays_out_of_the_object_and_is_drawn_in_around_it(digit):
    imprint = punch(digit)
    soft = deform(imprint, digit)
    assert (soft >= imprint).all()
    assert soft.max() <= 1e-3 * (1 + 1e-5)
    assert soft[0, 56, 60] > 1e-4  # four pixels outside
    assert soft[0, 5, 5] < 1e-9
    profile = soft[0, :61, 60]
    assert (profile.diff() >= 0).all()  # rises towards the contact


def test_longer_smoothing_reaches_further(digit):
    longer = replace(digit, gel_smoothing=tuple(2 * s for s in digit.gel_smoothing))
    assert deform(punch(digit), longer).sum() > 1.1 * deform(punch(digit), digit).sum()


def test_constant_stays_constant_up_to_the_border(digit):
    constant = torch.full((1, digit.height, digit.width), 1e-3)
    torch.testing.assert_close(deform(constant, digit), constant, rtol=1e-5, atol=0)


def test_input_is_left_alone(digit):
    imprint = punch(digit)
    deform(imprint, digit)
    assert torch.equal(imprint, punch(digit))
