"""Sounds as players in a notebook."""

import sys
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
import torch
from refusals import refused

from objectfolder.sound.notebook import players


@pytest.fixture
def notebook(monkeypatch):
    """A module IPython.display whose players are what they were given."""
    display = ModuleType("IPython.display")
    display.Audio = SimpleNamespace
    monkeypatch.setitem(sys.modules, "IPython", ModuleType("IPython"))
    monkeypatch.setitem(sys.modules, "IPython.display", display)


@pytest.mark.usefixtures("notebook")
def test_players_keep_relative_levels_within_full_scale():
    loud, soft = players(np.array([[0.0, 2e-6, -4e-6], [0.0, 1e-6, 0.0]]), 44100)
    np.testing.assert_allclose(loud.data, [0, 0.45, -0.9])
    np.testing.assert_allclose(soft.data, [0, 0.225, 0])
    assert (loud.rate, loud.normalize) == (44100, False)
    assert players(np.zeros(3), 16000)[0].data.tolist() == [0, 0, 0]


@pytest.mark.usefixtures("notebook")
def test_an_object_is_heard_in_a_notebook(brick):
    points, forces = brick.sample_surface(2), [[0, 0, 1.0], [0.1, 0, 0]]
    tensor = torch.tensor(points, requires_grad=True)
    heard = brick.listen(tensor, forces, duration=0.1, striker="wood")
    expected = brick.impact(points, forces, 44100, 0.1, "acceleration", striker="wood")
    louder = 0.9 / np.abs(expected).max() * expected
    np.testing.assert_allclose([player.data for player in heard], louder, rtol=1e-6)  # rounded


@pytest.mark.usefixtures("notebook")
def test_a_listener_hears_pressure_in_a_notebook(brick):
    strike = brick.sample_surface(1), [[0, 0, 1.0]]
    heard = brick.listen(*strike, duration=0.1, listener=[[0, 0, 1.0]])[0]
    expected = brick.impact(*strike, 44100, 0.1, listener=[[0, 0, 1.0]])[0]
    np.testing.assert_allclose(heard.data, 0.9 / np.abs(expected).max() * expected, rtol=1e-6)


@pytest.mark.usefixtures("notebook")
def test_spectrograms_are_heard_as_they_are_stored(spectrograms):
    heard = spectrograms.listen(spectrograms.sample_surface(1), [[0, 0, 1.0]])[0]
    assert (heard.rate, len(heard.data)) == (16000, 32000)


def test_without_ipython_it_says_so(monkeypatch):
    monkeypatch.setitem(sys.modules, "IPython", None)
    refused("need IPython", players, np.zeros(3), 16000)
