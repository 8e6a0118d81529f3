import torch

from objectfolder.touch.gel import deform


def punch(profile, depth=1e-3):
    image = torch.zeros(1, profile.height, profile.width)
    image[:, 60:100, 40:80] = depth
    return image


def test_rigid_gel_takes_the_imprint(flat):
    assert torch.equal(deform(punch(flat), flat), punch(flat))


def test_input_is_left_alone(digit):
    imprint = punch(digit)
    deform(imprint, digit)
    assert torch.equal(imprint, punch(digit))
