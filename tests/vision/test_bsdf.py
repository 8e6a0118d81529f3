import math

import numpy as np
import pytest
import torch

from objectfolder.vision.bsdf import principled


def directions(count, seed, lowest=-1.0):
    rng = np.random.default_rng(seed)
    z, phi = rng.uniform(lowest, 1, count), rng.uniform(0, 2 * np.pi, count)
    r = np.sqrt(1 - z * z)
    return torch.from_numpy(np.float32(np.stack([r * np.cos(phi), r * np.sin(phi), z], 1)))


UP = torch.tensor([[0.0, 0, 1]])
BASE = torch.tensor([[0.7, 0.3, 0.1]])


@pytest.mark.parametrize("roughness", [0.05, 0.25, 0.5, 1.0])
@pytest.mark.parametrize("metallic", [0.0, 0.4, 1.0])
def test_it_is_the_renderers(roughness, metallic):
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    look = {
        "base_color": {"type": "rgb", "value": BASE[0].tolist()},
        "roughness": roughness,
        "metallic": metallic,
    }
    bsdf = mi.load_dict({"type": "principled", "specular": 0.5} | look)
    eye, light = directions(300, 0, 0.02), directions(300, 1)
    light[:50] = torch.nn.functional.normalize(eye[:50] * torch.tensor([-1.0, -1, 1]) + 0.02, dim=1)
    expected = []
    for e, l in zip(eye.tolist(), light.tolist()):
        interaction = mi.SurfaceInteraction3f()
        interaction.wi, interaction.uv = e, [0.5, 0.5]
        expected.append(np.array(bsdf.eval(mi.BSDFContext(), interaction, l)))
    ours = principled(UP.expand(300, 3), -eye, light, BASE.expand(300, 3), roughness, metallic)
    np.testing.assert_allclose(ours, math.pi * np.array(expected), rtol=2e-3, atol=1e-4)


def test_a_black_one_reflects_what_fresnel_says():
    """Furnace test by quadrature over light directions: 4 % at normal incidence, from both sides nothing."""
    light = directions(400_000, 0, 0.0)
    eye, black = UP.expand(len(light), 3), torch.zeros(len(light), 3)
    reflected = 2 * principled(UP.expand(len(light), 3), -eye, light, black, 0.3, 0.0).mean()
    assert reflected.item() == pytest.approx(0.04, rel=0.03)
    below = principled(UP, -UP, -UP, BASE, 0.3, 0.0)
    assert (below == 0).all()
