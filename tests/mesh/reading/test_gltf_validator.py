"""What is written as glTF, against the Khronos glTF validator: `make gltf-validate` installs it."""

import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from gltf_scene import Scene, checker, square
from solids import box

from objectfolder.mesh.reading.load import FORMATS, default_up, load_mesh
from objectfolder.mesh.textured import TexturedMesh
from objectfolder.shapes import GENERATORS, generate
from objectfolder.sim import gltf, visual
from objectfolder.sim.hulls import convex_hulls

ROOT = Path(__file__).parents[3]
VALIDATOR = ROOT / "build" / ".npm" / "node_modules" / "gltf-validator"
OBJECTS = ROOT.parent / "shared" / "objects"
REAL = sorted(p for p in OBJECTS.glob("*/mesh.*") if p.suffix in FORMATS)

pytestmark = pytest.mark.skipif(
    shutil.which("node") is None or not VALIDATOR.is_dir(),
    reason="the Khronos glTF validator is not installed; run make gltf-validate (needs npm)",
)


def issues(path):
    command = ["node", str(Path(__file__).with_name("validate_gltf.mjs")), str(VALIDATOR), str(path)]
    return json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)


def assert_valid(mesh, tmp_path):
    lower, upper = mesh.bounds
    unit = mesh.with_vertices((mesh.vertices - (lower + upper) / 2) / (upper - lower).max())
    unit.write_glb(tmp_path / "visual.glb")
    found = issues(tmp_path / "visual.glb")
    # Of severity 2 is advice, such as for sizes that are powers of two.
    assert [m for m in found["messages"] if m["severity"] < 2] == []
    assert found["numErrors"] == found["numWarnings"] == 0


def test_the_validator_finds_faults(tmp_path):
    vertices, faces = box((1, 1, 1))
    TexturedMesh(vertices, faces + 1).write_glb(tmp_path / "m.glb")  # one index too many
    assert issues(tmp_path / "m.glb")["numErrors"] > 0


@pytest.mark.parametrize("path", REAL, ids=lambda p: p.parent.name)
def test_real_objects(path, tmp_path):
    assert_valid(load_mesh(path, default_up(path)), tmp_path)


@pytest.mark.parametrize("generator", sorted(GENERATORS))
def test_procedural_objects(generator, tmp_path):
    assert_valid(generate(generator), tmp_path)


@pytest.mark.parametrize("colors", [False, True])
@pytest.mark.parametrize("surface", [{}, {"roughness": 0.25, "metallic": 1.0}])
def test_objects_without_texture(colors, surface, tmp_path):
    vertices, faces = box((1, 2, 3))
    shades = np.arange(24, dtype=np.uint8).reshape(8, 3) * 10 if colors else None
    assert_valid(TexturedMesh(vertices, faces, vertex_colors=shades, **surface), tmp_path)


def test_exported_objects_but_for_extensions_that_it_does_not_know(brick, tmp_path, monkeypatch):
    monkeypatch.setattr(visual, "TEXELS", 64)
    path = gltf.write_glb(brick, tmp_path, hulls=convex_hulls(brick.to_mesh()))
    found = issues(path)
    assert found["numErrors"] == found["numWarnings"] == 0
    unknown = [m["message"] for m in found["messages"] if m["code"] == "UNSUPPORTED_EXTENSION"]
    assert len(unknown) == 2  # both drafts; their data are valid accessors


def test_plain_and_baked_objects(tmp_path):
    vertices, faces = box((1, 2, 3))
    texel = np.array([[[200, 40, 40]]], np.uint8)
    assert_valid(TexturedMesh(vertices, faces, np.zeros((8, 2)), texel), tmp_path)
    scene = Scene()
    scene.quads(0, scene.material(scene.texture(checker([[[9, 9, 9]]], 8))), [square(3, 3, 2)])
    scene.quads(1, scene.material(baseColorFactor=[0.5, 0.5, 0.5, 1]))
    scene.quads(2, None, COLOR_0=np.full((1, 4, 3), 0.25))
    assert_valid(load_mesh(scene.write(tmp_path / "scene.gltf"), "y"), tmp_path)
