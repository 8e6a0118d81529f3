"""Objects are found among the user's archives and folders, or the names that are there are shown."""

from pathlib import Path

import pytest

from objectfolder.base.errors import ObjectFolderError
from objectfolder.hub.fetch.catalogue import read_catalogue
from objectfolder.hub.fetch.files import find_local

OTHERS = ("024_bowl", "Barrel_02", "notes.txt", ".hidden", "025_mug.png", "gso_mug_white")


@pytest.fixture(scope="module")
def catalogue():
    return read_catalogue(Path(__file__).parents[3] / "catalogs/objectfolder1.yaml")


def fill(directory, names):
    for name in names:
        if "." in name[1:]:
            (directory / name).touch()
        else:
            (directory / name).mkdir()


@pytest.mark.parametrize(
    ("key", "name"),
    [
        ("ycb_mug", "025_mug"),
        ("ycb_mug", "ycb_mug"),
        ("ycb_mug", "YCB-025-Mug"),
        ("ycb_mug", "025_mug_google_16k.tgz"),
        ("ycb_mug", "025_mug_google_64k.tar.gz"),
        ("ycb_cup_a", "065-a_cups"),
        ("gso_bunny_racer", "BUNNY_RACER.ZIP"),
        ("gso_bunny_racer", "Bunny Racer"),
        ("polyhaven_barrel_01", "Barrel_01_1k.gltf.zip"),
        ("polyhaven_barrel_01", "polyhaven_barrel_01"),
    ],
)
def test_names_match_as_people_have_them(tmp_path, catalogue, key, name):
    fill(tmp_path, [*OTHERS, name])
    assert find_local(tmp_path, catalogue, key) == tmp_path / name


def test_an_exact_name_goes_before_a_longer_one(tmp_path, catalogue):
    fill(tmp_path, ["025_mug", "025_mug_old"])
    assert find_local(tmp_path, catalogue, "ycb_mug") == tmp_path / "025_mug"


def test_the_directory_may_be_the_object(tmp_path, catalogue):
    (tmp_path / "025_mug" / "google_16k").mkdir(parents=True)
    assert find_local(tmp_path / "025_mug", catalogue, "ycb_mug").name == "025_mug"


@pytest.mark.parametrize(
    ("names", "folder", "said"),
    [
        (
            ["025_mug", "ycb_mug", *OTHERS],
            "",
            r"2 candidates for ycb_mug \(025_mug\): 025_mug, ycb_mug; keep",
        ),
        ([*OTHERS, "026_mug"], "", "no archive or folder of ycb_mug.*025_mug_google_16k.*similar: 026_mug"),
        ([], "", "found: nothing"),
        ([], "gone", "--from .*gone is not a directory"),
    ],
)
def test_what_is_not_found_is_said(tmp_path, catalogue, names, folder, said):
    fill(tmp_path, names)
    with pytest.raises(ObjectFolderError, match=said):
        find_local(tmp_path / folder, catalogue, "ycb_mug")
