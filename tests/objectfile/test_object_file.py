import copy
import gc
import json
import math
import os
import pickle
import struct
import subprocess
import sys
import weakref
from functools import partial, reduce
from operator import getitem

import jsonschema
import numpy as np
import pytest
from brick import SCALE, SIDES, build_brick
from refusals import refused
from safetensors.numpy import save_file
from solids import box

from objectfolder import ObjectFile
from objectfolder.base.arrays import read_safetensors, write_safetensors
from objectfolder.base.errors import ObjectFolderError
from objectfolder.mesh.featurecodec import COUNTED, pack_features
from objectfolder.mesh.features import find_features
from objectfolder.mesh.topology import signed_volume
from objectfolder.stored.header import PARTS, format_name
from objectfolder.stored.kinds import schema

CAMERA, LIGHT = [2.0, 1.0, 1.0], [0.5, 0.5, 0.9]
ABSENT = object()
NO_MATERIALS = ("", " ", "steel\n", "=steel", "<b>steel</b>", "a|b", "a\x1b[2J", "acier\u202e", "a" * 101)
NO_MATERIAL = "material is .*, expected a name such as steel or unknown: letters"


def test_the_same_object_gives_the_same_bytes(brick, brick_path, tmp_path):
    brick.save(tmp_path / "a")
    build_brick().save(tmp_path / "b")
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes() == brick_path.read_bytes()


def test_an_object_says_what_it_is_in_one_line(brick, edit):
    held = "geometry, vision, audio, touch, radiation"
    assert repr(brick) == str(brick) == f"ObjectFile('brick': plastic, 0.1 m; {held})"
    small = ObjectFile({**brick.header, "scale": 0.0123456}, brick.tensors)
    assert repr(small) == f"ObjectFile('brick': plastic, 0.01235 m; {held})"
    assert repr(edit(lambda header: header.pop("touch"))).endswith("; geometry, vision, audio, radiation)")
    bare = {name: of for name, of in brick.header.items() if name not in held.split(", ")}
    assert repr(ObjectFile(bare, {})) == "ObjectFile('brick': plastic, 0.1 m; nothing)"
    assert "objectfolder" in brick._repr_html_()


def test_what_is_asked_for_is_held_or_all_that_is_held_is_listed(brick):
    held = "geometry, vision, audio, touch, radiation"
    brick.require(*held.split(", "))
    refused(f"^brick: the file holds no smell; it holds {held}$", brick.require, "smell")


def test_properties(brick):
    assert (brick.key, brick.material, brick.scale) == ("brick", "plastic", SCALE)
    assert len(brick.frequencies) == 12
    assert (np.diff(brick.frequencies) >= 0).all()
    points = brick.sample_surface(2000)
    np.testing.assert_allclose(np.ptp(points, axis=0), np.array(SIDES) * SCALE, atol=0.003)
    np.testing.assert_array_equal(points, brick.sample_surface(2000))
    assert not np.array_equal(points, brick.sample_surface(2000, seed=1))


def test_damaged_files_are_named(brick_path, tmp_path):
    whole, path = brick_path.read_bytes(), tmp_path / "damaged.safetensors"
    refused(r"damaged\.safetensors does not exist", ObjectFile.load, path)
    rng = np.random.default_rng(0)
    contents = [b"", whole[:7], whole[:-1], whole[: len(whole) // 2], rng.bytes(5000), b"\xff" * 64]
    contents += [whole[:1000] + b"\x00" * 8 + whole[1008:], b"PK\x03\x04" + whole]
    for content in contents:
        path.write_bytes(content)
        refused(r"damaged\.safetensors", ObjectFile.load, path)


def test_a_pickle_is_refused_and_never_run(tmp_path):
    class Attack:
        def __reduce__(self):
            return os.mkdir, (str(tmp_path / "pwned"),)

    (tmp_path / "p.safetensors").write_bytes(pickle.dumps(Attack()))
    refused(r"p\.safetensors", ObjectFile.load, tmp_path / "p.safetensors")
    assert not (tmp_path / "pwned").exists()


def test_any_other_safetensors_file_is_refused(tmp_path):
    write_safetensors(tmp_path / "net.safetensors", {"a": np.zeros(3)}, {"kind": "gains"})
    refused(
        r"net\.safetensors is not an Object File: its header lacks format",
        ObjectFile.load,
        tmp_path / "net.safetensors",
    )
    body = json.dumps({"a": {"dtype": "U8", "shape": [1], "data_offsets": [0, 1]}}).encode()
    (tmp_path / "bare").write_bytes(struct.pack("<Q", len(body)) + body + b"\0")
    refused("is not an Object File", ObjectFile.load, tmp_path / "bare")


@pytest.fixture
def edit(brick_path, tmp_path):
    """Write the brick with a changed header or without tensors, and load that."""

    def edit(change=lambda header: None, drop=(), **replaced):
        tensors, header = read_safetensors(brick_path)
        header = copy.deepcopy(header)
        change(header)
        tensors = {name: t for name, t in tensors.items() if name not in drop} | replaced
        whole = {name: np.ascontiguousarray(t) for name, t in tensors.items()}
        save_file(whole, tmp_path / "edited.safetensors", {"objectfolder": json.dumps(header)})  # NaN, too
        return ObjectFile.load(tmp_path / "edited.safetensors")

    return edit


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("format", "2.0", "has format 2.0, this version reads 1.x; update objectfolder"),
        ("format", "0.9", "has format 0.9, this version reads 1.x; rebuild it with `objectfolder build`"),
        ("format", "one", f"has format 'one', expected text like '{format_name()}'"),
        ("format", "", f"has format '', expected text like '{format_name()}'"),
        ("format", 1.0, "format: 1.0 is not of type 'string'"),
        ("vision", {"kind": "mesh"}, "vision of kind 'mesh', expected 'osf' or 'osf_hull' or 'surface'"),
        ("vision", {"kind": "surface"}, "vision: 'net' is a required property"),
        ("audio", {}, "audio: 'kind' is a required property"),
        ("touch", "image", "touch: 'image' is not of type 'object'"),
        ("scale", 0, "scale: 0 is less than the minimum of 1e-12"),
        ("scale", 1e-300, "scale: 1e-300 is less than the minimum of 1e-12"),
        ("scale", "big", "scale: 'big' is not of type 'number'"),
        ("scale", math.nan, "nor another readable safetensors file: its header holds NaN"),
        ("scale", True, "scale: True is not of type 'number'"),
        ("key", "../../etc/passwd", "key is '../../etc/passwd', expected a letter, then"),
        ("key", "a" * 1000, "key is .*, expected a letter, then"),
        ("key", "mug\n", "key is 'mug.n', expected a letter, then"),
        ("key", 3, "key: 3 is not of type 'string'"),
        *(("material", name, NO_MATERIAL) for name in NO_MATERIALS),
        ("material", None, "material: None is not of type 'string'"),
        ("geometry", {}, "geometry: 'kind' is a required property"),
        *(
            (field, ABSENT, f": its header: '{field}' is a required")
            for field in ("key", "material", "scale")
        ),
        ("format", ABSENT, "is not an Object File: its header lacks format"),
    ],
)
def test_a_header_with_a_wrong_field_or_without_it(edit, field, value, message):
    with pytest.raises(ObjectFolderError, match=rf"edited\.safetensors.*{message}"):
        edit(lambda header: header.pop(field) if value is ABSENT else header.update({field: value}))


def test_a_file_of_before_1_0_says_what_to_do(edit):
    with pytest.raises(ObjectFolderError, match=r"before format 1\.0; rebuild it with `objectfolder build`"):
        edit(lambda header: header.update(schema=header.pop("format")))


@pytest.mark.parametrize(
    ("path", "value"),
    [
        *(("geometry.resolution", value) for value in (10**6, -64, 64.5, "x")),
        *(("geometry.band", 0), ("geometry.predictor", "magic")),
        *(("vision.net.width", 10**9), ("vision.net.table_bits", 60), ("vision.net.roughness", 1e300)),
        *(("audio.net.resolution", 10**5), ("audio.band_hz", [0])),
        *(("touch.net.sensor.height", 10**8), ("touch.net.renderer", "cycles")),
    ],
)
def test_a_value_outside_its_range_is_refused_at_once(edit, path, value):
    """What would fill the memory never gets that far."""

    def change(header):
        *places, name = path.split(".")
        reduce(getitem, places, header)[name] = value

    refused(rf"edited\.safetensors: {path}.*objectfolder\.stored\.kinds", edit, change)


def test_the_schema_is_a_valid_one_that_describes_every_field_of_a_file(brick):
    jsonschema.Draft202012Validator.check_schema(schema())
    assert schema()["title"].endswith(f"format {format_name()}")
    assert brick.header.keys() <= schema()["properties"].keys()
    for part in PARTS:
        rules = schema()["properties"][part]["allOf"]
        rules = {rule["if"]["properties"]["kind"]["const"]: rule["then"]["properties"] for rule in rules}
        rule = rules[brick.header[part]["kind"]]
        rule |= schema()["properties"][part]["properties"]
        optional = {
            "truncated",
            "frequency_uncertainty",
            "frequency_uncertainty_unknown",
            "uncertain",
            *COUNTED,
        }
        assert brick.header[part].keys() == rule.keys() - optional
        if "net" in rule:
            assert brick.header[part]["net"].keys() == rule["net"]["properties"].keys()


def test_a_newer_minor_version_is_read_as_far_as_it_is_known(edit):
    file = edit(lambda header: header.update(format="1.7", weather="fine", vision={"kind": "hologram"}))
    assert file.touch(file.sample_surface(1)).shape == (1, 160, 120, 3)
    refused(r"brick: vision is of kind 'hologram'.*update objectfolder", file.view, CAMERA, LIGHT, 8)


QUESTIONS = {
    "geometry": lambda f: f.sample_surface(1),
    "vision": lambda f: f.view(CAMERA, LIGHT, 8),
    "audio": lambda f: f.impact([[0.05, 0, 0]], [[0, 0, 1]], duration=0.01),
    "touch": lambda f: f.touch([[0.05, 0, 0]]),
}


@pytest.mark.parametrize("part", PARTS)
def test_a_file_may_lack_a_part_and_then_says_so(edit, part):
    file = edit(lambda header: header.pop(part))
    refused(f"^brick: the file holds no {part}; it holds ", QUESTIONS[part], file)
    QUESTIONS["audio" if part != "audio" else "geometry"](file)


def test_without_geometry_points_are_taken_as_they_are(edit, brick):
    point = brick.sample_surface(1)
    file = edit(lambda header: header.pop("geometry"))
    near, same = (f.impact(point, [[0, 0, 1]], duration=0.05) for f in (brick, file))
    np.testing.assert_allclose(same, near, atol=0.02 * np.abs(near).max())
    assert np.isfinite(file.impact(point * 3, [[0, 0, 1]], duration=0.05)).all()


def test_damaged_geometry(edit, brick):
    packed = brick.tensors["geometry.distances"]
    flipped = packed.copy()
    flipped[len(packed) // 2] ^= 255
    for tensor in (flipped, packed[:-100], np.zeros(0, np.uint8), np.zeros(100, np.uint8)):
        file = edit(**{"geometry.distances": tensor})
        refused("distance grid is damaged", file.sample_surface, 3)
    with pytest.raises(ObjectFolderError, match=r"lacks tensor geometry\.distances"):
        edit(drop=["geometry.distances"]).sample_surface(3)


def test_features_sharpen_the_stored_surface(edit, brick):
    solid = box(SIDES)
    features = find_features(brick.surface.grid.values, *solid)
    stream = pack_features(features)

    def named(header, fewer=0):
        header["geometry"] |= features.counts | {"cells": len(features.cells) - fewer}

    file = edit(named, **{"geometry.features": stream})
    sharp = file.surface
    assert len(sharp.grid.features.cells) == len(features.cells) > 100
    kept = [signed_volume(one.vertices, one.faces) / np.prod(SIDES) for one in (brick.surface, sharp)]
    assert abs(kept[1] - 1) < 0.2 * abs(kept[0] - 1)
    assert file.to_mesh().is_watertight
    assert np.isfinite(file.view(CAMERA, LIGHT, 16)).all()
    assert file.touch(file.sample_surface(1)).shape == brick.touch(brick.sample_surface(1)).shape
    flipped = stream.copy()
    flipped[len(stream) // 2] ^= 255
    for change, tensor in ((named, flipped), (named, stream[:-100]), (partial(named, fewer=1), stream)):
        with pytest.raises(ObjectFolderError, match="distance grid is damaged"):
            edit(change, **{"geometry.features": tensor}).sample_surface(1)
    with pytest.raises(ObjectFolderError, match=r"lacks tensor geometry\.features"):
        edit(named).sample_surface(1)


def test_every_missing_tensor_is_an_error_of_its_question(edit, brick):
    radiation = partial(ObjectFile.impact, points=[[0.05, 0, 0]], forces=[[0, 0, 1]], listener=[0, 0, 1])
    for name in brick.tensors:
        with pytest.raises(ObjectFolderError, match="brick"):
            (QUESTIONS | {"radiation": radiation})[name.split(".")[0]](edit(drop=[name]))


def test_a_tensor_of_another_shape_or_a_config_that_does_not_fit(edit, brick):
    bias = "vision.appearance.0.bias"
    with pytest.raises(ObjectFolderError, match=r"^brick: the stored vision net is damaged"):
        edit(**{bias: brick.tensors[bias][:-1].copy()}).view(CAMERA, LIGHT, 8)
    for modality in ("vision", "audio", "touch"):
        for net in ({}, {"width": 3}, None, [1]):
            with pytest.raises(ObjectFolderError, match=rf"edited\.safetensors: {modality}\.net: "):
                edit(lambda header, modality=modality, net=net: header[modality].update(net=net))
        # A newer version may have more fields.
        QUESTIONS[modality](edit(lambda header, m=modality: header[m]["net"].update(colour=1)))


@pytest.mark.parametrize("name", ["vision.appearance.0.bias", "audio.damping"])
def test_numbers_that_are_none_are_refused(edit, brick, name):
    spoilt = brick.tensors[name].copy()
    spoilt[0] = np.nan
    with pytest.raises(ObjectFolderError, match=f"brick: tensor {name} holds values that are not finite"):
        QUESTIONS[name.split(".")[0]](edit(**{name: spoilt}))


@pytest.mark.parametrize("name", ["damped_frequency", "damping", "amplitude"])
@pytest.mark.parametrize("change", ["longer", "square", "negative"])
def test_modes_that_cannot_be_are_refused(edit, brick, name, change):
    value = brick.tensors[f"audio.{name}"].copy()
    changed = {"longer": np.append(value, value), "square": value[None], "negative": -value}[change]
    if change == "negative" and name == "amplitude":
        return  # the same shapes, upside down
    with pytest.raises(ObjectFolderError, match=r"^brick: the stored audio net is damaged .*modes"):
        edit(**{f"audio.{name}": changed}).impact([[0.05, 0, 0]], [[0, 0, 1]])


def test_only_what_a_question_needs_is_read(brick_path):
    file, read = ObjectFile.load(brick_path), []

    class Watched(dict):
        def __getitem__(self, name):
            read.append(name)
            return file.tensors[name]

    watched = ObjectFile(file.header, Watched.fromkeys(file.tensors))
    assert not read
    watched.frequencies  # noqa: B018
    assert read
    assert {name.split(".")[0] for name in read} == {"audio"}


BLOCKED = (
    "dvc igl manifold3d matplotlib mitsuba drjit networkx pydantic pymetis pyvista threadpoolctl trimesh"
)
SCRIPT = """
import sys
for name in sys.argv[2].split():
    sys.modules[name] = None
import numpy as np
from objectfolder import ObjectFile
file = ObjectFile.load(sys.argv[1])
points = file.sample_surface(2)
assert file.view([2, 1, 1], [1, 0, 1], 16).shape == (1, 16, 16, 3)
assert file.impact(points, np.ones((2, 3)), duration=0.1).shape == (2, 1600)
assert file.touch(points).shape == (2, 160, 120, 3)
assert (file.press(points, sensor="gelsight_mini").force > 0).all()
assert "PIL" not in sys.modules  # loading it takes a twentieth of the time to a first touch
assert "sympy" not in sys.modules  # a second, for which torch asks where nets on device meta draw numbers
print("answered")
"""


def test_the_base_install_answers(brick_path):
    """Nothing of the extra [build] is imported by a query."""
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(brick_path), BLOCKED], capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == "answered\n"


def test_a_file_that_nobody_needs_frees_its_memory_at_once():
    gc.disable()
    try:
        file = ObjectFile.sample("bell")
        points = file.sample_surface(3, seed=1)
        file.view(CAMERA, LIGHT, 24)
        file.view(CAMERA, resolution=8, lights="studio")
        file.impact(points, np.ones((3, 3)), duration=0.05)
        file.touch(points, 0.0008, 0.3)
        file.press(points[:1], sensor="gelsight_mini")
        gone = [weakref.ref(part) for part in (file.surface, file.touch_sense, file._parts.audio)]
        del file
        assert [part() for part in gone] == [None] * 3
    finally:
        gc.enable()
