"""Random valid files of the text formats, against what their generator knows, and the same damaged."""

import logging
from contextlib import suppress

import numpy as np
import pytest
from gltf_scene import colors_at
from random_meshes import PLAIN, WRITERS

from objectfolder.base.errors import ObjectFolderError
from objectfolder.mesh.reading.load import load_mesh, references

DAMAGE = (
    b"",
    b"",
    b"nan",
    b"-1",
    b"99999999999",
    b"1e400",
    b"x",
    b"0",
    b"#",
    b"\\",
    b"\xff",
    b"1,5",
    b"\n",
    b"list",
)


def compare(mesh, truth):
    """Compare triangles, whatever their order and first corners, and colours: of corners, or baked ones."""
    ours = mesh.vertices[mesh.faces]
    if mesh.texture is not None or truth.baked:
        colors, bound = np.repeat(colors_at(mesh)[:, None], 3, 1), 4
    else:
        plain = np.full((len(mesh.vertices), 3), PLAIN)
        colors, bound = (plain if mesh.vertex_colors is None else mesh.vertex_colors)[mesh.faces], 0
    rows = [sorted_rows(ours, colors), sorted_rows(np.array(truth.triangles), np.array(truth.colors))]
    np.testing.assert_array_equal(rows[0][..., :3], rows[1][..., :3])
    np.testing.assert_allclose(rows[0][..., 3:], rows[1][..., 3:], atol=bound)


def sorted_rows(triangles, colors):
    rows = np.concatenate([triangles, colors], 2)
    first = [np.lexsort(corners.T[2::-1])[0] for corners in triangles]
    rows = np.stack([np.roll(row, -f, 0) for row, f in zip(rows, first)])
    return rows[np.lexsort(rows[..., :3].reshape(len(rows), -1).T)]


def damaged(rng, data):
    """Delete, cut off or write over a few bytes."""
    for place in rng.integers(0, len(data) + 1, rng.integers(1, 4)):
        more = DAMAGE[rng.integers(len(DAMAGE))]
        data = data[:place] + more + (data[place + rng.integers(9) :] if rng.random() < 0.9 else b"")
    return data


@pytest.mark.parametrize("seeds", [range(60), pytest.param(range(2000), marks=pytest.mark.slow)], ids=len)
@pytest.mark.parametrize("kind", WRITERS)
def test_a_random_file_is_read_as_it_was_meant(tmp_path, caplog, kind, seeds):
    caplog.set_level(logging.WARNING)
    for seed in seeds:
        folder = tmp_path / str(seed)
        folder.mkdir()
        path, truth = WRITERS[kind](np.random.default_rng(seed), folder)
        try:
            compare(load_mesh(path), truth)
            assert all((folder / name).is_file() for name in references(path))
            path.write_bytes(damaged(np.random.default_rng(seed), path.read_bytes()))
            for read in (load_mesh, lambda p: list(references(p))):
                with suppress(ObjectFolderError):
                    read(path)
        except Exception as error:
            raise AssertionError(f"{path} of seed {seed}: {error}") from error
    assert not caplog.records
