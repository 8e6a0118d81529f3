"""Objects of any dimensions that are not refused are solids, whose charts are whole."""

import inspect
import re
from typing import Any

import pytest
from assembled import check_charts, check_solid, welded
from hypothesis import HealthCheck, Phase, assume, given, settings
from hypothesis import strategies as st
from procedural_cases import APPLIANCES, GENUS, SMALL

from objectfolder.base.errors import ObjectFolderError
from objectfolder.shapes import GENERATORS, generate
from objectfolder.shapes.toy import KINDS

#: By generator, the dimensions that the limits of all others follow from.
FAST = {
    "mug": ("radius", "height"),
    "die": ("edge",),
    "bell": ("radius", "height"),
    "bowl": ("radius", "height"),
    "cup": ("radius", "height"),
    "plate": ("radius",),
    "bottle": ("radius", "height"),
    "vase": ("radius", "height"),
    "pan": ("radius", "height", "handle_length"),
    "teapot": ("radius", "height"),
}
SLOW = {
    "table": ("length", "width", "height"),
    "stool": ("diameter", "height"),
    "shelf": ("width", "depth", "height"),
    "wrench": ("flats",),
    "hammer": ("head_diameter", "head_length", "length"),
    "spoon": ("bowl_length", "bowl_width", "depth", "length", "rise"),
    "block": ("length", "width", "height"),
    "airplane": ("length",),
    "toy": ("span",),
}
#: Options that are no dimensions, and dimensions that may be 0.
OPTIONS: dict[str, dict[str, list[Any]]] = {
    "bowl": {"lobes": [0, 3, 12]},
    "cup": {"lobes": [0, 5], "stem": [0, 1]},
    "plate": {"lobes": [0, 4]},
    "bottle": {"lobes": [0, 4], "collar": [0, 1]},
    "vase": {"lobes": [0, 8]},
    "table": {"shape": ["rectangle", "oval"], "base": ["legs", "pillar"], "apron": [0, 1]},
    "stool": {"legs": [3, 4, 5, 6], "rung_height": [0, 1]},
    "shelf": {"bays": [1, 2, 4], "front": ["open", "doors", "drawers"], "back": [0, 1]},
    "wrench": {"ends": ["combination", "open", "ring"]},
    "hammer": {"head": ["claw"]},
    "spoon": {"hook": [0, 1]},
    "block": {"rows": [1, 2, 4], "columns": [1, 3], "hole": ["round", "star", "mixed"]},
    "toy": {"kind": list(KINDS), "count": [3, 8]},
}
slow = [HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.filter_too_much]
once = {"derandomize": True, "phases": [Phase.generate]}
any_size = settings(max_examples=6, deadline=None, suppress_health_check=slow, **once)


def drawn(generator: str, main: tuple[str, ...], data: st.DataObject, texels: int) -> Any:
    """An object whose dimensions are each drawn from the range that the refusal of a huge one names."""
    asked = inspect.signature(GENERATORS[generator]).parameters
    scale, share = data.draw(st.floats(0.5, 2)), st.floats(0.1, 0.9)
    given = {name: scale * data.draw(st.floats(0.85, 1.2)) * asked[name].default for name in main}
    given |= {name: 1e9 for name, of in asked.items() if isinstance(of.default, float) and name not in main}
    for name, choices in OPTIONS.get(generator, {}).items():
        chosen = data.draw(st.sampled_from(choices))
        if name not in given or chosen == 0:
            given[name] = chosen
    for _ in range(3 * len(given)):
        try:
            return generate(generator, **given, texture_size=texels)
        except ObjectFolderError as error:
            found = re.search(r": (\w+)=.*: expected (\S+) to (\S+), ", str(error))
            assume(found is not None)
            name, low, high = found[1], float(found[2]), float(found[3])
            assume(low < high)
            given[name] = low + data.draw(share) * (high - low)
    return assume(False)


@pytest.mark.parametrize("generator", [*FAST, *(pytest.param(name, marks=pytest.mark.slow) for name in SLOW)])
@any_size
@given(st.data())
def test_any_sane_object_is_solid(generator, data):
    # Those that are assembled from parts have many charts.
    texels = 64 if generator in FAST and generator not in ("pan", "teapot") else SMALL
    mesh = drawn(generator, (FAST | SLOW)[generator], data, texels)
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
