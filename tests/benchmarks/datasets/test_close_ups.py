import numpy as np
import pytest
import torch
from brick import felt_by
from refusals import refused

from objectfolder.benchmarks.datasets import close_ups
from objectfolder.benchmarks.datasets.close_ups import (
    close_up_request,
    has_close_ups,
    open_points,
    sample_close_ups,
)
from objectfolder.benchmarks.datasets.observations import CloseUps
from objectfolder.objectfile import close_views as looking
from objectfolder.objectfile.close_views import close_views
from objectfolder.objectfile.file import ObjectFile

SIZE = (16, 12)


@pytest.fixture(scope="module")
def bell():
    return ObjectFile.sample("bell")


@pytest.mark.slow
def test_the_same_folder_again_and_not_for_another_request(bell, tmp_path):
    one, two, request = tmp_path / "one", tmp_path / "two", close_up_request(bell, 20, SIZE, 3)
    for folder in (one, two):
        assert not has_close_ups(request, folder)
        sample_close_ups(bell, 20, SIZE, 3, folder)
        assert has_close_ups(request, folder)
    assert {path.name: path.read_bytes() for path in one.iterdir()} == {
        path.name: path.read_bytes() for path in two.iterdir()
    }
    assert not has_close_ups(close_up_request(bell, 20, SIZE, 4), one)
    (two / "view.npy").unlink()
    assert not has_close_ups(request, two)
    table = CloseUps({"bell": one})
    assert table.shape("view") == table.shape("touch") == (*SIZE, 3)
    assert len(table) == 20


@pytest.mark.slow
def test_a_view_shows_where_the_gel_is_pressed(bell):
    """A pixel is background where no surface lies under the gel: the gel is not pressed in there."""
    points, distances = open_points(bell, 60, seed=0)
    views = close_views(bell, points, distances, (40, 30))
    pressed = bell.press(points, 0.001).mask.reshape(60, 40, 4, 30, 4).mean((2, 4)) > 0.5
    empty = (views == 255).all(3)
    some = empty.any((1, 2)) & pressed.any((1, 2))
    assert some.sum() >= 5
    assert (empty & pressed)[some].sum() < 0.02 * pressed[some].sum()
    for wrong in (empty[:, ::-1], empty[:, :, ::-1]):  # upside down, mirrored
        assert (wrong & pressed)[some].sum() > 0.04 * pressed[some].sum()


def test_a_view_covers_what_a_wide_gel_does(bell):
    """Whatever the pixels' shape: two sizes of images show the same, averaged to one."""
    wide = felt_by(bell, "gelsight_mini")
    points, distances = open_points(wide, 20, seed=0)
    views = [close_views(wide, points, distances, size) for size in ((48, 64), (48, 32), (24, 96))]
    means = [view.reshape(20, 12, view.shape[1] // 12, 16, -1, 3).mean((2, 4)) for view in views]
    assert np.abs(means[0] - means[1]).mean() < 0.01 * 255
    assert np.abs(means[0] - means[2]).mean() < 0.01 * 255
    gel = wide.sensor_profile
    narrow = close_views(felt_by(bell, "digit"), points, distances, (48, 64))
    assert gel.half_extent[1] > gel.half_extent[0]
    assert np.abs(views[0].astype(float) - narrow).mean() > 0.02 * 255


def test_cameras_stand_where_the_gel_comes_from(bell, monkeypatch):
    """It comes along the contact normal, which differs from that of the surface by some degrees."""
    points, distances = open_points(bell, 60, seed=0)
    outward = bell.contact_normals(points)
    surface = bell.surface.grid.normals(torch.from_numpy((points / bell.scale).astype(np.float32))).numpy()
    assert (outward * surface).sum(1).min() < 0.999
    place = (points / bell.scale).astype(np.float32)
    free, _ = bell.surface.caster.first_hit(
        (place + looking.LIFT * outward).astype(np.float32), outward.astype(np.float32)
    )
    expected = np.minimum(looking.CLEAR * bell.scale * free, looking.FARTHEST)
    np.testing.assert_allclose(distances, expected, atol=1e-4)
    seen = []

    def drawn(drawer, cameras):
        seen.append(cameras.poses)
        return np.zeros((1, 16, 12, 3))

    monkeypatch.setattr(looking, "view_images", drawn)
    close_views(bell, points, distances, SIZE)
    cameras = np.concatenate(seen)
    np.testing.assert_allclose(cameras[:, :3, 2], outward, atol=1e-6)
    np.testing.assert_allclose(
        cameras[:, :3, 3] * bell.scale - points, distances[:, None] * outward, atol=1e-6
    )
    assert distances.min() >= close_ups.NEAREST
    assert distances.max() <= looking.FARTHEST
    assert distances.min() < 0.6 * looking.FARTHEST  # inside the bell


def test_an_object_without_room_is_refused(bell, monkeypatch):
    monkeypatch.setattr(close_ups, "NEAREST", 0.2)
    refused("bell: 0 of 40 random points leave 20 cm for a camera", open_points, bell, 10, seed=0)


@pytest.mark.parametrize("size", [(10, 12), (12, 10), (161, 120)])
def test_sizes_that_cannot_be_scored_or_felt_are_refused(bell, size):
    refused(rf"bell: encode.touch is \[{size[0]}, {size[1]}\], expected", close_up_request, bell, 10, size, 0)
