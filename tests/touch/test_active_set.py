import numpy as np
import pytest

from objectfolder.touch.active_set import settle, supporting_pressure
from objectfolder.touch.gel import Layer, indent, respond

GEL = Layer(0.004, 1.5e5, 0.48)
PITCH = 2e-4


@pytest.fixture
def ball():
    rows, columns = np.indices((60, 50))
    square = ((rows - 28.3) ** 2 + (columns - 25.1) ** 2) * PITCH**2
    return (0.001 - square / (2 * 0.01)).clip(-6e-4).astype(np.float32)


def test_the_pressure_moves_active_pixels_as_asked(rng):
    wanted, active = rng.normal(size=(40, 50)), rng.random((40, 50)) < 0.4
    pressure = supporting_pressure(wanted, active, PITCH, GEL)
    assert not pressure[~active].any()
    assert np.abs(respond(pressure, PITCH, GEL) - wanted)[active].max() < 1e-9


def test_a_settled_contact_has_neither_overlap_nor_tension(ball):
    rough, pressure = indent(ball, PITCH, GEL)
    displacement, settled = settle(ball, pressure, PITCH, GEL)
    reachable = ball > -6e-4
    assert settled.min() >= 0
    assert (displacement - ball)[reachable].min() > -1e-11
    assert np.abs((displacement - ball) * settled).max() == 0
    assert np.abs(displacement - rough).max() < 0.02 * ball.max()
