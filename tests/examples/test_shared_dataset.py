"""examples/shared_dataset.py on a release of the samples, from a folder and from an address."""

import numpy as np
import pytest
from index_rows import BELL
from matplotlib.figure import Figure
from PIL import Image
from refusals import refused

from examples.shared_dataset import CAMERA, PIXELS, draw_sizes, draw_views, main
from objectfolder import Dataset, ObjectFile
from objectfolder.base.io import file_digest
from objectfolder.hub.release.entries import index_text
from objectfolder.objectfile.dataset import INDEX, IndexEntry
from objectfolder.objectfile.samples import available_samples, sample_path

UNKNOWN = {"modes": 0, "lowest_hz": None, "attribution": ""}


def entry(key):
    """Of a sample in the index, which knows neither modes of the die nor whom to credit for it."""
    file, path = ObjectFile.sample(key), sample_path(key)
    heard = {"modes": len(file.frequencies), "lowest_hz": file.frequencies.min()}
    held = {"path": f"objects/{path.name}", "bytes": path.stat().st_size, "sha256": file_digest(path)}
    own = {"key": key, "material": file.material, "size": file.scale}
    return IndexEntry(
        **BELL | own | heard | held | (UNKNOWN if key == "die" else {"attribution": "A. Smith"})
    )


@pytest.fixture(scope="module")
def release(tmp_path_factory):
    """A release of the samples: the pages of its address by path, as in its folder."""
    entries = [entry(key) for key in available_samples()]
    pages = {INDEX: index_text(entries).encode()}
    return pages | {item.path: sample_path(item.key).read_bytes() for item in entries}


@pytest.fixture
def folder(release, tmp_path):
    (tmp_path / "release" / "objects").mkdir(parents=True)
    for name, content in release.items():
        (tmp_path / "release" / name).write_bytes(content)
    return tmp_path / "release"


def test_a_release_is_checked_and_drawn_from_a_folder_as_from_an_address(
    release, folder, publisher, tmp_path, monkeypatch, capsys
):
    main(str(folder), tmp_path / "sheet")
    first, *credits = capsys.readouterr().out.splitlines()
    assert first == f"Dataset('{folder}'): 3 objects, all as released"
    assert credits == ["bell: CC0-1.0, A. Smith", "die: CC0-1.0, =YCB, https://a.b", "mug: CC0-1.0, A. Smith"]
    sheet = tmp_path / "sheet" / "sheet.webp"
    with Image.open(sheet) as picture:
        assert picture.size == (1200, 600)
    assert sheet.stat().st_size < 150_000

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    publisher.pages = {f"/three/{name}": content for name, content in release.items()}
    main(f"{publisher.url}/three", tmp_path / "again")
    assert {path for path, _ in publisher.requests} == publisher.pages.keys()
    assert (tmp_path / "again" / "sheet.webp").read_bytes() == sheet.read_bytes()


def test_a_changed_file_is_named_and_nothing_is_drawn(folder, tmp_path):
    (folder / "objects" / "die.safetensors").write_bytes(b"damaged")
    refused("missing or changed since release: die", main, str(folder), tmp_path / "sheet")
    assert not (tmp_path / "sheet").exists()


def test_each_panel_shows_its_object(folder):
    figure, dataset = Figure(), Dataset(folder)
    draw_views(figure, dataset)
    shown = [place for place in figure.axes if place.images]
    assert [place.get_title().split("\n")[0] for place in shown] == [*dataset.keys]
    for place, file in zip(shown, dataset):
        view = file.view(CAMERA, lights="studio", resolution=PIXELS)[0]
        np.testing.assert_array_equal(place.images[0].get_array(), view)


def test_the_chart_has_the_figures_of_the_index_in_their_units(folder):
    figure, entries = Figure(), Dataset(folder).entries
    draw_sizes(figure, entries)
    (axes,) = figure.axes
    points = {dots.get_label(): dots.get_offsets().tolist() for dots in axes.collections}
    expected = {item.material: [[100 * item.size, item.lowest_hz]] for item in entries if item.lowest_hz}
    assert points == {
        material: [pytest.approx(place) for place in places] for material, places in expected.items()
    }
    assert sorted(text.get_text() for text in axes.texts) == ["bell", "mug"]
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("longest side (cm)", "lowest mode (Hz)")
