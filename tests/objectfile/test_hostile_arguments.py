"""Whatever is asked, an Object File answers with numbers or refuses with a message."""

import math
from dataclasses import fields, is_dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import torch
from refusals import refused

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.materials import Material, material
from objectfolder.objectfile import query_files
from objectfolder.touch.profiles import load_profile
from objectfolder.vision import query as vision
from objectfolder.vision.cameras import Intrinsics, look_at

CAMERA, LIGHT, TOP, UP = [2.0, 1.0, 1.0], [0.5, 0.5, 0.9], [[0.0, 0.0, 0.015]], [[0.0, 0.0, 1.0]]
VIEW = {"camera": CAMERA, "light": LIGHT, "resolution": 4, "intrinsics": None, "supersample": True}
TOUCH = {"points": TOP, "depth": 0.001, "angle": 0.0, "tilt": 0.0, "azimuth": 0.0, "tolerance": 0.02}
STRIKE = {"points": TOP, "forces": UP, "sample_rate": 1000, "duration": 0.001, "response": "displacement"}
STRIKE |= {"tolerance": 0.02, "contact_time": 0.0, "material": None, "scale": None}
STRIKE |= {"listener": [[0.0, 0.0, 1.0]], "delay": False}
#: Questions to a file, by name and a remark, and arguments that are all valid.
QUESTIONS = {
    "view": VIEW,
    "render": VIEW,
    "impact": STRIKE,
    "impact by a striker": {"points": TOP, "forces": UP, "duration": 0.001, "striker": "wood"},
    "mode_shapes": {"points": TOP, "tolerance": 0.02},
    "tuning": {"material": "iron", "scale": 1.0},
    "contact_time": {"striker": "wood", "material": "iron", "scale": 1.0},
    "touch": TOUCH | {"sensor": None},
    "press": TOUCH | {"sensor": None},
    "press and move": {"points": TOP, "shear": [1e-4, 0], "twist": 0.05, "friction": 0.5, "markers": False},
    "contact_normals": {"points": TOP, "tolerance": 0.02},
    "depth_maps": {name: value for name, value in TOUCH.items() if name != "angle"},
    "sample_surface": {"count": 2, "seed": 0},
    "nearest": {"points": TOP},
    "base_colors": {"points": [[0.0, 0.0, 0.15]]},
}
#: Functions that draw queries, with arguments that are all valid.
DRAWS = {
    "sample_views": {"count": 2, "seed": 0, "radius": 2.5, "light_radius": 1.0},
    "sample_strikes": {"count": 2, "seed": 0, "force": 1.0, "directions": "random"},
    "sample_presses": {"count": 2, "seed": 0},
}
NUMBERS = (
    *(math.nan, math.inf, -math.inf, 0, -0.0, -1, 1, 0.5, 1e-300, -1e-300, 5e-324, 1e300, -1e300, 1e9, 2**31),
    *(2**63, -(2**63), 10**30, 10**400, 10**5000, np.float16(0.5), np.float32(np.inf), np.int8(3)),
    *(np.uint64(1), np.longdouble(1) * 2**1000, Fraction(1, 3), np.array(2.0), torch.tensor(1.5)),
    *(torch.tensor(1e-3).half(),),
)
OTHERS = (
    *(None, True, False, np.True_, "", "1", "nan", "x" * 5000, "\0", b"1", 1j, [], (), {}, {"a": 1}, {1}),
    *(object(), object, Path("x"), range(3), [None] * 3, [[]], [[[]]], ["1", "2", "3"], [True] * 3, [1j] * 3),
    *([[1, 2], [3]], [[math.nan, 0, 0]], [[math.inf, 0, 0]], [[1e200, 0, 0]], [[-1e308] * 3], [1e39, 0, 0]),
    *([10**400, 0, 0], [0, 0, 0], [0, 0, 1e-320], [[1e-9, 0, 0]], [1, 2], [1, 2, 3, 4], np.zeros((0, 3))),
    *(np.zeros((3, 0)), np.zeros((2, 3, 3)), np.zeros((2, 3), object), np.zeros(3, "M8[s]")),
    *(np.zeros(3, [("x", float)]), np.ma.masked, np.ma.array([[0.0, 0, 0.01]], mask=[[1, 0, 0]]), np.eye(4)),
    *(np.eye(4)[None] * 2, np.zeros((4, 4)), look_at(np.array(CAMERA)).transpose(0, 2, 1)),
    *(look_at(np.array(CAMERA)) * 1e200, torch.zeros(1, 3, dtype=torch.bool)),
    *(torch.zeros(1, 3, dtype=torch.complex64), torch.zeros(3, device="meta"), torch.zeros(1, 3).to_sparse()),
    *(torch.full((1, 3), torch.nan), Intrinsics(2, 2, 1e-300), Intrinsics(2, 2, 1e300)),
    *(Intrinsics(2, 2, 1.0, (1e300, 0)), Intrinsics(10**9, 10**9), (2, 2, 1.0), lambda: 0),
    *(Material("m", 1e-300, 1e300, 0.3, 0, 0), Material("m", 1e300, 1e-300, -0.9, 0, 1e300)),
    *(material("wood"), load_profile("gelsight_mini")),
)


def arrays_of(answer):
    """Every array of numbers in an answer."""
    if isinstance(answer, torch.Tensor):
        return [answer.numpy()]
    if isinstance(answer, np.ndarray):
        return [answer]
    if isinstance(answer, float):
        return [np.array(answer)]
    if isinstance(answer, tuple):
        return [array for part in answer for array in arrays_of(part)]
    if is_dataclass(answer):
        return [array for field in fields(answer) for array in arrays_of(getattr(answer, field.name))]
    return []


def refused_or_numbers(ask, arguments, name, value):
    try:
        answer = ask(**arguments | {name: value})
    except ObjectFolderError:
        return
    assert arrays_of(answer)
    for array in arrays_of(answer):
        assert not np.isnan(array).any(), (name, value)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    ("question", "name"), [(question, name) for question, given in QUESTIONS.items() for name in given]
)
def test_any_argument_is_refused_or_answered_with_numbers(brick, question, name):
    for value in (*NUMBERS, *OTHERS):
        refused_or_numbers(getattr(brick, question.split()[0]), QUESTIONS[question], name, value)


@pytest.mark.parametrize(("draw", "name"), [(draw, name) for draw, given in DRAWS.items() for name in given])
def test_any_query_that_is_drawn_is_one(brick, draw, name):
    given = DRAWS[draw] if draw == "sample_views" else {"obj": brick, **DRAWS[draw]}
    for value in (*NUMBERS, *OTHERS):
        refused_or_numbers(getattr(query_files, draw), given, name, value)


@pytest.mark.parametrize("name", ["radius", "light_radius"])
def test_views_that_are_drawn_can_be_asked_for(brick, name):
    for value in (1e-6, 1e3):
        views = query_files.sample_views(2, **{name: value})
        assert np.isfinite(brick.view(views[:, :3], views[:, 3:], 8)).all()
    for value in (1e9, 1001, 1e-9, 0, -1):
        refused(
            rf"^{name} is .*, expected 1e-06 to 1000, in the unit frame",
            query_files.sample_views,
            2,
            **{name: value},
        )


@pytest.mark.parametrize("draw", ["view", "render", "torch"])
@pytest.mark.parametrize("cameras", [np.tile(CAMERA, (10**6, 1)), np.tile(np.eye(4), (10**6, 1, 1))])
def test_more_views_than_fit_are_refused_by_their_number(brick, monkeypatch, draw, cameras):
    for of_each_row in ("look_at", "require_rigid", "PointLight", "broadcast_rows"):
        monkeypatch.delattr(vision, of_each_row)
    ask = brick.torch().view if draw == "torch" else getattr(brick, draw)
    for camera, light in ((cameras, LIGHT), (cameras[:1], np.tile(LIGHT, (10**6, 1)))):
        refused("1000000 images of 4096 x 4096 pixels: needs", ask, camera, light, resolution=4096)
