"""Objects of any dimensions that are not refused are solids, whose charts are whole."""

from typing import Any

import pytest
from assembled import check_charts, check_solid, welded
from hypothesis import HealthCheck, Phase, assume, given, settings
from hypothesis import strategies as st
from procedural_cases import APPLIANCES, GENUS, SMALL, STARTERS

from objectfolder.shapes import generate
from objectfolder.shapes.toy import KINDS

Sizes = dict[str, Any]
unit = st.floats(0, 1)


def mug(radius: float, slim: float, thick: float, deep: float, far: float) -> Sizes:
    height = radius * (1.2 + 1.8 * slim)
    bottom = radius * 0.10 + deep * (0.2 * height - radius * 0.10)
    wall, reach = radius * (0.05 + 0.10 * thick), radius * (0.3 + 0.1 * far)
    return {"radius": radius, "height": height, "wall": wall, "bottom": bottom, "handle_reach": reach}


def die(size: float, rounding: float) -> Sizes:
    return {"edge": size, "fillet": rounding * size}


def bell(radius: float, slender: float, thickness: float) -> Sizes:
    return {"radius": radius, "height": radius * slender, "wall": radius * thickness}


def bowl(radius: float, tall: float, thick: float, full: float, flare: float, lobes: int) -> Sizes:
    height = radius * (0.25 + 2.25 * tall)
    wall = 0.015 * radius + thick * (min(0.15 * radius, 0.2 * height) - 0.015 * radius)
    foot = {"foot_radius": (0.25 + 0.45 * full) * radius, "foot_height": 0.2 * height}
    shape = {"fullness": 1.6 + 6 * full, "flare": flare, "lobes": lobes}
    return {"radius": radius, "height": height, "wall": wall} | shape | foot


def goblet(radius: float, thick: float, wide: float, bulge: float, stem: float) -> Sizes:
    base = radius * (0.5 + wide)
    wall = 0.02 * radius + thick * (0.15 * min(radius, base) - 0.02 * radius)
    foot = {"stem": 4 * radius * stem, "foot_radius": radius * (0.5 + 0.8 * wide)}
    sides = {"wall": wall, "base_radius": base, "rounding": 0.9 * base, "bulge": bulge}
    return {"radius": radius, "height": 4 * radius} | sides | foot


def bottle(radius: float, narrow: float, thick: float, proud: float, waist: float, lobes: int) -> Sizes:
    neck = radius * (0.2 + 0.7 * narrow)
    wall = 0.02 * radius + thick * (0.3 * neck - 0.02 * radius)
    top = {"neck_radius": neck, "neck_height": 1.2 * radius, "collar": proud * (radius - neck)}
    body = {"shoulder": radius, "waist": waist, "lobes": lobes}
    return {"radius": radius, "height": 5 * radius, "wall": wall} | top | body


def vase(radius: float, base: float, neck: float, lip: float, thick: float, belly: float) -> Sizes:
    radii = [radius * (0.2 + 0.8 * share) for share in (base, neck, lip)]
    wall = 0.02 * radius + thick * (0.25 * min(radii) - 0.02 * radius)
    others = dict(zip(("base_radius", "neck_radius", "lip_radius"), radii))
    return {"radius": radius, "height": 3 * radius, "wall": wall, "belly": belly, "neck": 0.93} | others


def pan(radius: float, deep: float, wide: float, rise: float) -> Sizes:
    height = radius * (0.25 + 1.3 * deep)
    body = {"wall": 0.02 * radius, "base_radius": radius * (0.6 + 0.4 * wide), "rounding": 0.3 * height}
    handle = {"handle_length": 1.5 * radius, "handle_width": 0.2 * radius, "handle_rise": 0.7 * rise * radius}
    handle["handle_thickness"] = min(0.1 * radius, 0.3 * height)
    return {"radius": radius, "height": height} | body | handle


def teapot(radius: float, slim: float, thick: float, full: float, reach: float) -> Sizes:
    body = {"radius": radius, "height": slim * radius, "wall": thick * radius, "fullness": full}
    reaches = {"spout_reach": radius * (0.5 + 0.8 * reach), "handle_reach": radius * (0.45 + 0.75 * reach)}
    return body | reaches | {"lid_radius": radius * (0.35 + 0.3 * reach)}


def table(width: float, long: float, high: float, thick: float, slim: float, shape: str, base: str) -> Sizes:
    length, height = width * (1 + 1.5 * long), width * (0.4 + high)
    top = 0.01 * length + thick * (0.2 * height - 0.01 * length)
    leg = 0.03 * length + slim * (0.14 * width - 0.03 * length)
    under = {"apron": 0.2 * thick * (height - top), "overhang": 0.15 * width * slim}
    sizes = {"length": length, "width": width, "height": height, "top": top, "leg_size": leg}
    return sizes | under | {"taper": 0.4 + 0.6 * high, "shape": shape, "base": base, "bevel": 0.0}


def stool(diameter: float, high: float, thick: float, slim: float, wide: float, legs: int) -> Sizes:
    height = diameter * (0.6 + 2.2 * high)
    seat = 0.05 * diameter + thick * (0.2 * height - 0.05 * diameter)
    leg = diameter * (0.05 + 0.1 * slim)
    rung = leg + thick * (0.69 * (height - seat) - leg) if wide > 0.3 else 0
    sizes = {"diameter": diameter, "height": height, "seat": seat, "leg_diameter": leg, "legs": legs}
    return sizes | {"splay": 0.3 * height * wide, "rung_height": rung, "dish": 0.25 * seat * slim}


def shelf(width: float, deep: float, high: float, thick: float, bays: int, front: str) -> Sizes:
    depth, height = width * (0.3 + 0.5 * deep), width * (0.9 + high)
    t = 0.013 * max(width, height) + thick * 0.008 * width
    assume(t <= 0.12 * depth and bays <= height / (5 * t))
    back = 0.5 * t * (1 + thick) if deep > 0.4 else 0
    sizes = {"width": width, "depth": depth, "height": height, "board_thickness": t, "back": back}
    return sizes | {"bays": bays, "front": front, "plinth": 0.1 * height * high, "bevel": 0.1 * t * thick}


def wrench(size: float, long: float, thick: float, ends: str) -> Sizes:
    length, thickness = size * (6.1 + 20 * long), size * (0.21 + 0.48 * thick)
    return {"length": length, "flats": size, "thickness": thickness, "ends": ends}


def hammer(diameter: float, long: float, slim: float, reach: float, head: str) -> Sizes:
    low, high = {"claw": (3.3, 5.4), "club": (1.7, 3.9), "mallet": (1.25, 2.9)}[head]
    head_length = diameter * (low + long * (high - low))
    width = diameter * (0.5 + 0.55 * slim)
    length = min(max(head_length * (1.1 + 2 * reach), 5.1 * width), 24 * width)
    assume(length <= 5 * head_length)
    sizes = {"length": length, "head_length": head_length, "head_diameter": diameter}
    return sizes | {"handle_width": width, "head": head}


def spoon(bowl: float, wide: float, deep: float, thick: float, far: float, hooked: bool) -> Sizes:
    width = bowl * (0.45 + 0.5 * wide)
    depth = width * (0.16 + 0.7 * deep)
    wall = 0.021 * width + thick * (0.44 * depth - 0.021 * width)
    length, handle = bowl * (1.8 + 4 * far), width * (0.12 + 0.32 * thick)
    rise = 1.4 * length * far * deep
    hook = min(0.12 * length, 0.5 * rise)
    sizes = {"length": length, "bowl_length": bowl, "bowl_width": width, "depth": depth, "wall": wall}
    bend = {"rise": rise, "hook": hook if hooked and 0.8 * handle < hook else 0, "point": 0.3 * wide}
    return sizes | bend | {"handle_width": handle}


def block(
    length: float, wide: float, high: float, fat: float, rows: int, columns: int, hole: str, blind: bool
) -> Sizes:
    width, height = length * (0.3 + 0.7 * wide), length * (0.15 + 0.7 * high)
    pitch = min(length / columns, width / rows)
    diameter = pitch * (0.25 + 0.5 * fat)
    rounding = 0.9 * min(0.2 * (pitch - diameter), 0.15 * diameter, 0.1 * min(width, height)) * high
    sizes = {"length": length, "width": width, "height": height, "diameter": diameter, "rounding": rounding}
    holes = {"rows": rows, "columns": columns, "hole": hole, "depth": 0.5 * height if blind else None}
    return sizes | holes | {"relief": "holes"}


def toy(size: float, plump: float, count: int, kind: str) -> Sizes:
    return {"kind": kind, "span": size, "plump": plump, "count": count}


one_of = st.sampled_from
few = st.integers(1, 4)
#: By generator: what its sizes are, and what they are computed from; the second table takes minutes.
FAST = {
    "mug": (mug, st.floats(0.02, 0.08), unit, unit, unit, unit),
    "die": (die, st.floats(0.01, 0.2), st.floats(0.02, 0.16)),
    "bell": (bell, st.floats(0.02, 0.15), st.floats(1.6, 3.0), st.floats(0.03, 0.07)),
    "bowl": (bowl, st.floats(0.02, 0.15), unit, unit, unit, st.floats(-0.4, 0.6), one_of([0, 3, 12])),
    "cup": (goblet, st.floats(0.02, 0.08), unit, unit, st.floats(-0.25, 0.4), st.floats(0.25, 0.6)),
    "bottle": (bottle, st.floats(0.02, 0.1), unit, unit, unit, st.floats(0, 0.35), one_of([0, 4])),
    "vase": (vase, st.floats(0.02, 0.1), unit, unit, unit, unit, st.floats(0.2, 0.8)),
    "pan": (pan, st.floats(0.05, 0.15), unit, unit, unit),
    "teapot": (
        *(teapot, st.floats(0.04, 0.12), st.floats(1.3, 3.0), st.floats(0.03, 0.09)),
        *(st.floats(1.8, 5), unit),
    ),
}
SLOW = {
    "table": (
        *(table, st.floats(0.4, 1.2), unit, unit, unit, unit),
        *(one_of(["rectangle", "oval"]), one_of(["legs", "pillar"])),
    ),
    "stool": (stool, st.floats(0.2, 0.5), unit, unit, unit, unit, st.integers(3, 6)),
    "shelf": (
        *(shelf, st.floats(0.4, 1.5), unit, unit, unit, st.integers(1, 6)),
        one_of(["open", "doors", "drawers"]),
    ),
    "wrench": (wrench, st.floats(0.005, 0.04), unit, unit, one_of(["combination", "open", "ring"])),
    "hammer": (hammer, st.floats(0.015, 0.08), unit, unit, unit, one_of(["claw", "club", "mallet"])),
    "spoon": (spoon, st.floats(0.03, 0.1), unit, unit, unit, unit, st.booleans()),
    "block": (
        *(block, st.floats(0.03, 0.3), unit, unit, unit, few, few),
        *(one_of(["round", "star", "mixed"]), st.booleans()),
    ),
    "toy": (toy, st.floats(0.03, 0.5), st.floats(0.75, 1.3), st.integers(3, 8), one_of(KINDS)),
}
slow = [HealthCheck.too_slow, HealthCheck.data_too_large]
once = {"derandomize": True, "phases": [Phase.generate]}
any_size = settings(max_examples=6, deadline=None, suppress_health_check=slow, **once)


@pytest.mark.parametrize("generator", [*FAST, *(pytest.param(name, marks=pytest.mark.slow) for name in SLOW)])
@any_size
@given(st.data())
def test_any_sane_object_is_solid(generator, data):
    build, *shares = (FAST | SLOW)[generator]
    parameters = build(*(data.draw(share) for share in shares))
    if generator in FAST and generator not in STARTERS:
        parameters["finish"] = "plastic"
    # Those that are assembled from parts have many charts.
    texels = 64 if generator in FAST and generator not in ("pan", "teapot") else SMALL
    mesh = generate(generator, **parameters, texture_size=texels)
    check_solid(mesh)
    if generator != "toy":
        check_charts(mesh)
    if generator in FAST:
        assert welded(mesh).euler_number == 2 - 2 * GENUS[generator]


@pytest.mark.slow
@pytest.mark.parametrize("name", APPLIANCES)
@any_size
@given(st.floats(0.03, 2.0), st.floats(0.8, 1.25))
def test_any_sane_appliance_is_solid(name, size, plump):
    generator, parameters = APPLIANCES[name]
    mesh = generate(generator, **parameters, span=size, plump=plump, texture_size=SMALL)
    check_solid(mesh)
    check_charts(mesh)
    assert welded(mesh).euler_number == 2 - 2 * GENUS[name]
