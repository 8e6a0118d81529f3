import numpy as np
import pytest
import torch
from refusals import refused

from objectfolder.nets.fit import Session
from objectfolder.touch.image_net import ImageTouch
from objectfolder.touch.image_training import train_image
from objectfolder.touch.net_settings import ImageConfig

SHAPE = {"width": 48, "depth": 3, "point_octaves": 4, "pixel_octaves": 3}
RATES = {"learning_rate": 0.004, "final_rate": 0.01, "precision": "float32"}
CONFIG = ImageConfig(**SHAPE, **RATES, steps=500, batch=512)
SCALE = 0.1


def dots(count, seed):
    """Contacts at random points, each image a bright dot whose place follows the point."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-0.5, 0.5, (count, 3)) * SCALE
    rows, columns = np.mgrid[:16, :12]
    row, column = (8 + 60 * points[:, :1, None]), (6 + 60 * points[:, 1:2, None])
    bright = np.exp(-((rows - row) ** 2 + (columns - column) ** 2) / 8)
    images = (60 + 150 * bright[..., None] * [1, 0.5, 0.2]).round().astype(np.uint8)
    pose = {"depths": np.full(count, 0.001), "angles": np.full(count, 0.3)}
    return {"images": images, "points": points} | pose


def train(contacts):
    session = Session(torch.Generator().manual_seed(3))
    return train_image(contacts, contacts, SCALE, "digit", CONFIG, session)


@pytest.fixture(scope="module")
def learnt():
    contacts = dots(5, 0)
    return contacts, *train(contacts)


def error(images, truth):
    return np.mean((images.astype(float) - truth) ** 2)


def test_it_memorises_contacts_far_better_than_their_mean_image(learnt):
    contacts, net, curve = learnt
    truth = contacts["images"]
    found = error(net.images(contacts["points"] / SCALE), truth)
    assert found < error(truth.mean(0, keepdims=True), truth) / 30
    assert curve[-1].val_loss == pytest.approx(found / 255**2, rel=0.2)


def test_the_papers_network():
    """Eight layers of 256 channels, 105 inputs from (x, y, z, w, h) with ten octaves each, RGB out."""
    net = ImageTouch("digit", (160, 120), (0.001, 0.0), 256, 8, 10, 10).network
    sizes = [tuple(layer.weight.shape) for layer in (*net.hidden, net.output)]
    assert sizes == [(256, 105), *[(256, 256)] * 4, (256, 361), *[(256, 256)] * 2, (3, 256)]


def test_pixels_are_columns_and_rows_from_left_and_top():
    net = ImageTouch("digit", (4, 3), (0.001, 0.0), 8, 2, 0, 0)
    seen = []
    net.network.register_forward_hook(lambda module, inputs, output: seen.append(inputs[0]))
    net.images(np.array([[0.1, 0.2, 0.3]]))
    np.testing.assert_allclose(seen[0][:, :3], np.tile([[0.2, 0.4, 0.6]], (12, 1)), rtol=1e-6)
    np.testing.assert_allclose(seen[0][:4, 3:], [[-1, -1], [0, -1], [1, -1], [-1, -1 / 3]], atol=1e-6)


def test_images_do_not_depend_on_the_batch(learnt):
    contacts, net, _ = learnt
    points = contacts["points"] / SCALE
    np.testing.assert_array_equal(net.images(points[3:4])[0], net.images(points)[3])
    assert net.images(points[:0]).shape == (0, 16, 12, 3)


def test_stored_weights_answer_nearly_alike(learnt):
    contacts, net, _ = learnt
    back = ImageTouch.from_tensors(*net.to_tensors())
    points = contacts["points"] / SCALE
    assert np.abs(back.images(points).astype(int) - net.images(points)).max() <= 3
    assert (back.press_depth, back.angle, back.image_size) == (0.001, 0.3, (16, 12))


@pytest.mark.parametrize(("name", "field"), [("depths", "depth"), ("angles", "angle")])
def test_contacts_of_several_depths_or_angles_are_refused(name, field):
    contacts = dots(4, 0)
    contacts[name][2] += 1e-4
    message = rf"contacts have {name} from .*give render_touch\.{field} a value"
    refused(message, train, contacts)
