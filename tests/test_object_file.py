import copy
import json
import math
import os
import pickle
import struct
import subprocess
import sys

import numpy as np
import pytest
import torch
from brick import SCALE, SIDES, build_brick

from objectfolder import ObjectFile
from objectfolder.artifacts import read_safetensors, write_safetensors
from objectfolder.errors import ObjectFolderError

CAMERA, LIGHT = [2.0, 1.0, 1.0], [0.5, 0.5, 0.9]


def ask(file):
    points = file.sample_surface(3, seed=1)
    return (
        file.view(CAMERA, LIGHT, 24),
        file.impact(points, np.ones((3, 3)), duration=0.05),
        file.touch(points, 0.0008, 0.3),
    )


def test_a_file_answers_as_the_object_that_was_saved(brick, tmp_path):
    brick.save(tmp_path / "a.safetensors")
    back = ObjectFile.load(tmp_path / "a.safetensors")
    for a, b in zip(ask(brick), ask(back)):
        np.testing.assert_array_equal(a, b)
    assert back.header == brick.header


def test_the_same_object_gives_the_same_bytes(brick, brick_path, tmp_path):
    brick.save(tmp_path / "a")
    build_brick().save(tmp_path / "b")
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes() == brick_path.read_bytes()


def test_properties(brick):
    assert (brick.key, brick.material, brick.scale) == ("brick", "plastic", SCALE)
    assert len(brick.frequencies) == 12
    assert (np.diff(brick.frequencies) >= 0).all()
    points = brick.sample_surface(2000)
    np.testing.assert_allclose(np.ptp(points, axis=0), np.array(SIDES) * SCALE, atol=0.003)
    np.testing.assert_array_equal(points, brick.sample_surface(2000))
    assert not np.array_equal(points, brick.sample_surface(2000, seed=1))


def test_geometry_is_lossless(brick):
    assert brick.surface.grid.values.shape == (64, 64, 64)
    assert brick.surface.grid.distance(torch.zeros(1, 3)) < 0


def test_a_missing_file(tmp_path):
    with pytest.raises(ObjectFolderError, match=r"none\.safetensors does not exist"):
        ObjectFile.load(tmp_path / "none.safetensors")


def test_damaged_files_are_named(brick_path, tmp_path):
    whole, path = brick_path.read_bytes(), tmp_path / "damaged.safetensors"
    rng = np.random.default_rng(0)
    contents = [b"", whole[:7], whole[:-1], whole[: len(whole) // 2], rng.bytes(5000), b"\xff" * 64]
    contents += [whole[:1000] + b"\x00" * 8 + whole[1008:], b"PK\x03\x04" + whole]
    for content in contents:
        path.write_bytes(content)
        with pytest.raises(ObjectFolderError, match=r"damaged\.safetensors"):
            ObjectFile.load(path)


def test_a_pickle_is_refused_and_never_run(tmp_path):
    class Attack:
        def __reduce__(self):
            return os.mkdir, (str(tmp_path / "pwned"),)

    (tmp_path / "p.safetensors").write_bytes(pickle.dumps(Attack()))
    with pytest.raises(ObjectFolderError, match=r"p\.safetensors"):
        ObjectFile.load(tmp_path / "p.safetensors")
    assert not (tmp_path / "pwned").exists()


def test_any_other_safetensors_file_is_refused(tmp_path):
    write_safetensors(tmp_path / "net.safetensors", {"a": np.zeros(3)}, {"kind": "gains"})
    with pytest.raises(
        ObjectFolderError, match=r"net\.safetensors is not an Object File: its header lacks schema, key"
    ):
        ObjectFile.load(tmp_path / "net.safetensors")
    body = json.dumps({"a": {"dtype": "U8", "shape": [1], "data_offsets": [0, 1]}}).encode()
    (tmp_path / "bare").write_bytes(struct.pack("<Q", len(body)) + body + b"\0")
    with pytest.raises(ObjectFolderError, match="is not an Object File"):
        ObjectFile.load(tmp_path / "bare")


@pytest.fixture
def edit(brick_path, tmp_path):
    """Write the brick with a changed header or without tensors, and load that."""

    def edit(change=lambda header: None, drop=(), **replaced):
        tensors, header = read_safetensors(brick_path)
        header = copy.deepcopy(header)
        change(header)
        tensors = {name: t for name, t in tensors.items() if name not in drop} | replaced
        write_safetensors(tmp_path / "edited.safetensors", tensors, header)
        return ObjectFile.load(tmp_path / "edited.safetensors")

    return edit


@pytest.mark.parametrize(
    "field", ["schema", "key", "material", "scale", "geometry", "vision", "audio", "touch"]
)
def test_a_header_without_a_field(edit, field):
    with pytest.raises(ObjectFolderError, match=rf"edited\.safetensors .*lacks {field}"):
        edit(lambda header: header.pop(field))


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("schema", 3, "has schema 3, this version reads 2; update objectfolder"),
        ("schema", 1, "has schema 1, this version reads 2; rebuild it with `objectfolder build`"),
        ("vision", {"kind": "mesh"}, "vision net of kind 'mesh', expected 'surface' or 'osf'"),
        ("audio", {}, "audio net of kind None, expected 'gains'"),
        ("touch", "image", "touch net of kind None, expected 'geometric' or 'image'"),
        ("scale", 0, "scale is 0"),
        ("scale", -1.0, "scale is -1.0"),
        ("scale", "big", "scale is 'big'"),
        ("scale", math.nan, "scale is nan"),
    ],
)
def test_a_header_with_a_wrong_field(edit, field, value, message):
    with pytest.raises(ObjectFolderError, match=rf"edited\.safetensors.*{message}"):
        edit(lambda header: header.update({field: value}))


@pytest.mark.parametrize(
    ("geometry", "message"),
    [
        ({}, "resolution"),
        ({"resolution": 64}, "band"),
        ({"resolution": 10**6, "band": 0.04}, "resolution 1000000"),
        ({"resolution": -64, "band": 0.04}, "resolution -64"),
        ({"resolution": 65, "band": 0.04}, "reshape"),
        ({"resolution": "x", "band": 0.04}, "int"),
        ([], "indices"),
    ],
)
def test_a_wrong_description_of_the_geometry(edit, geometry, message):
    file = edit(lambda header: header.update(geometry=geometry))
    for question in (lambda: file.surface, lambda: file.touch([[0.05, 0, 0]])):
        with pytest.raises(
            ObjectFolderError, match=rf"^brick: the stored distance grid is damaged .*{message}"
        ):
            question()


def test_damaged_geometry(edit, brick):
    packed = brick.tensors["geometry.sdf_lzma"]
    flipped = packed.copy()
    flipped[len(packed) // 2] ^= 255
    for tensor in (flipped, packed[:-100], np.zeros(0, np.uint8), np.zeros(100, np.uint8)):
        file = edit(**{"geometry.sdf_lzma": tensor})
        with pytest.raises(ObjectFolderError, match="distance grid is damaged"):
            file.sample_surface(3)
    with pytest.raises(ObjectFolderError, match=r"lacks tensor geometry\.sdf_lzma"):
        edit(drop=["geometry.sdf_lzma"]).sample_surface(3)


def test_every_missing_tensor_is_an_error_of_its_question(edit, brick):
    questions = {
        "geometry": lambda f: f.sample_surface(1),
        "vision": lambda f: f.view(CAMERA, LIGHT, 8),
        "audio": lambda f: f.impact(f.sample_surface(1), [[0, 0, 1]], duration=0.01),
    }
    for name in brick.tensors:
        group = name.split(".")[0]
        if group == "touch":  # only the evaluation reads it
            continue
        with pytest.raises(ObjectFolderError, match="brick"):
            questions[group](edit(drop=[name]))


def test_a_tensor_of_another_shape_or_a_config_that_does_not_fit(edit, brick):
    bias = "vision.appearance.0.bias"
    with pytest.raises(ObjectFolderError, match=r"^brick: the stored vision net is damaged"):
        edit(**{bias: brick.tensors[bias][:-1].copy()}).view(CAMERA, LIGHT, 8)
    for modality, question in (
        ("vision", lambda f: f.view(CAMERA, LIGHT, 8)),
        ("audio", lambda f: f.frequencies),
        ("touch", lambda f: f.touch(f.sample_surface(1))),
    ):
        for net in ({}, {"width": 3}, None, [1]):

            def change(header, modality=modality, net=net):
                header[modality]["net"] = net

            with pytest.raises(ObjectFolderError, match=f"^brick: the stored {modality} net is damaged"):
                question(edit(change))
        with pytest.raises(ObjectFolderError, match=f"^brick: the stored {modality} net is damaged"):
            question(edit(lambda header, m=modality: header[m].pop("net")))


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
print("answered")
"""


def test_the_base_install_answers(brick_path):
    """Nothing of the extra [build] is imported by a query."""
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(brick_path), BLOCKED], capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == "answered\n"
