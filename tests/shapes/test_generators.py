"""What holds for the objects of every generator."""

import inspect
from functools import cache

import numpy as np
import pytest
from assembled import check_charts, check_charts_apart, check_solid, check_texture, welded
from procedural_cases import APPLIANCES, CASES, GENUS, SAMPLE, SMALL, STARTERS, VESSELS
from refusals import refused

from objectfolder.base.errors import ObjectFolderError
from objectfolder.mesh.textured import TexturedMesh
from objectfolder.shapes import GENERATORS, generate
from objectfolder.shapes.parameters import Size

NAMES = [
    pytest.param(name, marks=pytest.mark.slow) if name in APPLIANCES and name not in SAMPLE else name
    for name in CASES
]


@cache
def made(name: str) -> TexturedMesh:
    generator, parameters = CASES[name]
    return GENERATORS[generator](**parameters, texture_size=SMALL)


@pytest.mark.parametrize("name", NAMES)
def test_object_is_one_closed_solid_with_a_texture_of_its_own(name):
    mesh = made(name)
    check_solid(mesh)
    check_charts(mesh)
    check_charts_apart(mesh)
    check_texture(mesh)
    assert mesh.texture.shape == (SMALL, SMALL, 3)
    assert len(np.unique(mesh.texture.reshape(-1, 3), axis=0)) > (500 if name in STARTERS else 30)
    assert 1000 <= len(mesh.faces) <= (23_000 if name in VESSELS else 20_500)
    if GENUS.get(name) is not None:
        assert welded(mesh).euler_number == 2 - 2 * GENUS[name]


@pytest.mark.parametrize("name", [n for n in NAMES if n not in (*STARTERS, *VESSELS)])
def test_vertices_are_even_enough_to_strike_anywhere(name):
    """No edge is long against the object, flats included."""
    mesh = made(name)
    corners = mesh.vertices[mesh.faces]
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    size = np.ptp(mesh.bounds, axis=0).max()
    assert edges.max() < 0.18 * size
    assert np.quantile(edges, 0.98) < 0.09 * size


@pytest.mark.parametrize("name", [*STARTERS, *VESSELS])
def test_colours_agree_across_seams(name):
    """Both sides of a chart's border show the same colour."""
    mesh = made(name)
    texel = np.clip(np.round(mesh.uv * SMALL - 0.5), 0, SMALL - 1).astype(int)
    colour = mesh.texture[::-1][texel[:, 1], texel[:, 0]].astype(float)
    _, group = np.unique(mesh.vertices, axis=0, return_inverse=True)
    group = group.ravel()
    mean = np.stack([np.bincount(group, colour[:, k]) / np.bincount(group) for k in range(3)], 1)
    twins = np.bincount(group)[group] > 1
    if name == "mug":  # the handle meets the painted wall at a real edge of colour
        twins &= (mesh.vertices[:, 0] < 0.9 * 0.041) | (np.abs(mesh.vertices[:, 1]) < 1e-9)
    assert twins.sum() > 100
    limit, share = (25, 0.95) if name in STARTERS else (30, 0.93)
    assert np.mean(np.abs(colour - mean[group])[twins].max(1) < limit) > share


@pytest.mark.parametrize("generator", GENERATORS)
def test_every_dimension_is_a_finite_number_that_fits_the_others(generator):
    """One that is out of its range, or that puts another one out of its range."""
    beside = r"\S+ to \S+, .+; change \1 or the dimensions beside it"
    limits = rf"{generator}: (\w+)=.*: expected ({beside}|a positive, finite number)"
    parameters = inspect.signature(inspect.unwrap(GENERATORS[generator])).parameters.values()
    dimensions = [p for p in parameters if isinstance(p.default, float)]
    assert dimensions
    for one in dimensions:
        positive = one.annotation == Size
        if (generator, one.name) != ("cup", "foot_radius"):  # unused without a stem
            for wrong in (np.nan, "big", True, *((0.0, -1, np.inf) if positive else ())):
                words = "a positive, finite number" if positive else ""
                with pytest.raises(
                    ObjectFolderError, match=f"{generator}: {one.name}={wrong!r}: expected {words}"
                ):
                    generate(generator, **{one.name: wrong})
            if one.name == "span" and generator != "airplane":  # the only length
                continue
            for wrong in (1e9, 1e-9) if positive else (1e9, -1e9):
                refused(limits, generate, generator, **{one.name: wrong})


TABLE = {"length": 1.5, "width": 0.8, "height": 0.74, "top": 0.03, "leg_size": 0.06, "apron": 0.08}
TABLE |= {"overhang": 0.03, "bevel": 0.002}
BLOCK = {"length": 0.1, "width": 0.08, "height": 0.04, "diameter": 0.016, "depth": 0.02, "rounding": 0.001}


@pytest.mark.parametrize(
    ("generator", "lengths", "options"),
    [
        ("table", TABLE, {}),
        ("block", BLOCK, {}),
        pytest.param("appliance", {"span": 0.1}, {"kind": "iron"}, marks=pytest.mark.slow),
    ],
)
def test_object_of_twice_the_size_has_eight_times_the_volume(generator, lengths, options):
    small, large = (
        generate(generator, **{k: scale * v for k, v in lengths.items()}, **options, texture_size=SMALL)
        for scale in (1, 2)
    )
    assert welded(large).volume == pytest.approx(8 * welded(small).volume, rel=1e-9)


@pytest.mark.parametrize(
    ("generator", "parameters", "words"),
    [
        ("anvil", {}, "unknown generator 'anvil'.*bell, block.*wrench"),
        ("mug", {"colour": 3}, "unknown parameter 'colour'.*radius"),
        ("mug", {"handle_reach": 0.3}, "handle_reach=0.3.*handle"),
        ("mug", {"texture_size": 0}, "texture_size=0.*texels"),
        ("mug", {"texture_size": 100.5}, "texture_size=100.5.*texels"),
        ("die", {"fillet": 0.02}, "fillet=0.02.*pips"),
        ("bowl", {"lobes": 2}, "bowl: lobes=2.*from 3 to 12"),
        ("bowl", {"finish": "velvet"}, "unknown finish 'velvet'"),
        ("cup", {"stem": 0.09}, "cup: stem=0.09.*65 %"),
        ("cup", {"stem": -1.0}, r"cup: stem=-1\.0.*positive"),
        ("teapot", {"texture_size": 64}, "texture_size=64.*charts.*larger"),
        ("table", {"shape": "star"}, "shape='star'.*rectangle, oval"),
        ("table", {"base": "one"}, "base='one'.*legs, pillar"),
        ("stool", {"legs": 2}, "legs=2.*whole number from 3 to 6"),
        ("stool", {"legs": 3.5}, "legs=3.5.*whole number"),
        ("stool", {"color": "red"}, "color='red'.*hexadecimal"),
        ("shelf", {"bays": 0}, "bays=0.*whole number from 1 to 8"),
        ("shelf", {"bays": 8, "height": 0.5, "width": 0.5}, "height=0.5.*room for those bays"),
        ("shelf", {"front": "glass"}, "front='glass'.*open, doors, drawers"),
        ("wrench", {"ends": "hook"}, "ends='hook'.*combination, open, ring"),
        ("hammer", {"head": "axe"}, "head='axe'.*claw, club, mallet"),
        ("block", {"rows": 0}, "rows=0.*whole number"),
        ("block", {"depth": 0.0499}, "depth=0.0499.*floor"),
        ("block", {"relief": "slots"}, "relief='slots'.*plain, holes, studs"),
        ("toy", {"kind": "robot"}, "kind='robot'.*car, truck, duck, rings"),
        ("toy", {"count": 20}, "count=20.*whole number"),
        ("electronics", {"kind": "lantern"}, "kind='lantern'.*television, radio, clock"),
        ("appliance", {"kind": "oven"}, "kind='oven'.*toaster, lantern, iron, dryer"),
    ],
)
def test_impossible_requests_are_refused(generator, parameters, words):
    refused(words, generate, generator, **parameters)
