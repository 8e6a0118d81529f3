import json
from dataclasses import replace

import numpy as np
import pytest
from solids import box, join, sphere

from objectfolder.base.arrays import write_npz
from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.io import write_json
from objectfolder.sound.fem.settings import VoxelizeConfig
from objectfolder.sound.fem.voxelize import voxelize

SIDES = (1.0, 0.5, 0.25)
GRIDS = {"resolutions": (8, 6), "subdivisions": 4, "max_degrees_of_freedom": 10**6, "sdf_resolution": 48}
CONFIG = VoxelizeConfig(element="cut_cell_hex20", **GRIDS)


def test_report_states_what_both_grids_hold():
    solid = box(SIDES)
    voxels = voxelize(solid, solid, CONFIG)
    cells, grid = voxels.report["cells"], voxels.report["distance_grid"]
    assert cells["resolution"] == 8
    assert cells["cells"] == len(voxels.cells.index) == 8 * 4 * 2
    nodes = 9 * 5 * 3 + 8 * 5 * 3 + 9 * 4 * 3 + 9 * 5 * 2  # corners, and middles of edges
    assert cells["degrees_of_freedom"] == 3 * nodes
    assert cells["volume"] == grid["volume"] == pytest.approx(np.prod(SIDES))
    assert cells["volume_error"] == voxels.cells.volume_error
    assert abs(cells["volume_error"]) < 0.01
    assert cells["dropped_volume_share"] == 0
    assert cells["winding"] == grid["winding"]
    assert cells["winding"]["residual_columns"] == cells["winding"]["outside_fraction"] == 0
    # The shadows along the axes, at 128 columns per unit length.
    assert cells["winding"]["columns"] == pytest.approx(128**2 * (0.5 + 0.25 + 0.125), rel=0.02)
    assert grid["resolution"] == len(voxels.values) == 48
    assert grid["band"] == voxels.band
    assert grid["volume_share_kept"] == pytest.approx(1, abs=0.03)
    area = 2 * (0.5 + 0.25 + 0.125)
    assert grid["samples_in_band"] == pytest.approx(area * 2 * voxels.band / (1.04 / 47) ** 3, rel=0.1)


def test_cut_cells_have_even_grids_whose_errors_can_be_estimated():
    with pytest.raises(ValueError, match=r"resolutions: 33 is odd, expected even numbers"):
        replace(CONFIG, resolutions=(33, 24))
    assert replace(CONFIG, element="hex8", resolutions=(33,)).resolutions == (33,)


def test_sound_may_have_another_solid_than_sight_and_touch():
    apart = join(box((0.45, 0.5, 0.25), (-0.275, 0, 0)), box((0.45, 0.5, 0.25), (0.275, 0, 0)))
    report = voxelize(apart, box(SIDES), CONFIG).report
    assert report["cells"]["volume"] == pytest.approx(np.prod(SIDES))
    assert report["distance_grid"]["volume"] == pytest.approx(0.9 * np.prod(SIDES))


@pytest.mark.parametrize("broken", ["surface", "solid"])
def test_an_open_surface_is_refused_by_name(broken):
    good = box(SIDES)
    meshes = {"surface": good, "solid": good, broken: (good[0], good[1][1:])}
    with pytest.raises(ObjectFolderError, match=r"^crate: the surface is open: .* \d+ of \d+ columns"):
        voxelize(**meshes, config=CONFIG, name="crate")


def test_same_bytes_twice(tmp_path):
    for name in ("a", "b"):
        voxels = voxelize(sphere(0.5, 3), sphere(0.5, 3), CONFIG)
        write_npz(tmp_path / f"{name}.npz", **vars(voxels.cells), values=voxels.values)
        write_json(tmp_path / f"{name}.json", voxels.report)
    for suffix in ("npz", "json"):
        assert (tmp_path / f"a.{suffix}").read_bytes() == (tmp_path / f"b.{suffix}").read_bytes()
    assert json.loads((tmp_path / "a.json").read_text()) == voxels.report
