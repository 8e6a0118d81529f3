"""The small files of situations from the field: tests skip without them."""

from pathlib import Path

import numpy as np
import pytest
from gltf_scene import colors_at
from refusals import refused

from objectfolder.mesh.reading.load import default_up, load_mesh

CASES = Path(__file__).parents[4] / "shared" / "cases"
WITHOUT = [pytest.param(None, marks=pytest.mark.skip(reason="needs the shared cases"))]
FILES = [path.relative_to(CASES) for suffix in ("obj", "ply", "stl") for path in CASES.rglob(f"*.{suffix}")]


@pytest.mark.parametrize("path", sorted(FILES) or WITHOUT, ids=str)
def test_a_file_from_the_field_is_a_box_with_its_colours(path):
    if path.parts[0] == "05_decimal_comma":
        refused("decimal commas: export with points", load_mesh, CASES / path)
        return
    mesh = load_mesh(CASES / path, default_up(path))
    found = None
    if mesh.texture is not None or mesh.vertex_colors is not None:
        found = {tuple(color) for color in np.rint(colors_at(mesh)).astype(int)}
    if path.parts[0] == "04_obj_colours_on_one_object":
        assert found == {(255, 0, 0), (203, 203, 203)}  # a red box beside a plain one
        return
    a, b, c = mesh.vertices[mesh.faces].transpose(1, 0, 2)
    np.testing.assert_allclose(np.ptp(mesh.vertices, axis=0), [0.1, 0.06, 0.04], atol=1e-6)
    assert np.einsum("fc,fc->", a, np.cross(b, c)) / 6 == pytest.approx(240e-6)
    known = {
        "06_obj_vt_of_one_or_three_numbers": {(255, 0, 0), (0, 255, 0)},
        "08_unicode_form_of_names": {(10, 200, 30)},
        "09_stl_binary_solid_header": {(255, 0, 0)},
        "36_mtl_colorspace_option": {(10, 200, 30)},
    }
    assert path.parts[0] not in known or found == known[path.parts[0]]
