"""Objects are found among the user's archives and folders, or the names that are there are shown."""

import pytest
from refusals import refused

from objectfolder.hub.fetch.files import find_local

OTHERS = ("024_bowl", "Barrel_02", "notes.txt", ".hidden", "025_mug.png", "gso_mug_white")


def fill(directory, names):
    for name in names:
        path = directory / name
        path.touch() if path.suffix else path.mkdir()


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
        ("polyhaven_barrel_01", "ph_Barrel_01"),
        ("ycb_cup_a", "ycb_065a_cups"),
    ],
)
def test_names_match_as_people_have_them(tmp_path, catalogue, key, name):
    fill(tmp_path, [*OTHERS, name])
    assert find_local(tmp_path, catalogue, key) == tmp_path / name


def test_a_published_name_goes_before_the_key(tmp_path, catalogue):
    """The key of one object may be the name of another."""
    fill(tmp_path, ["gso_school_bus", "gso_sonny_school_bus"])
    assert find_local(tmp_path, catalogue, "gso_school_bus") == tmp_path / "gso_sonny_school_bus"


def test_an_exact_name_goes_before_a_longer_one_and_the_directory_may_be_the_object(tmp_path, catalogue):
    fill(tmp_path, ["025_mug", "025_mug_old"])
    assert find_local(tmp_path, catalogue, "ycb_mug") == tmp_path / "025_mug"
    (tmp_path / "025_mug" / "google_16k").mkdir()
    assert find_local(tmp_path / "025_mug", catalogue, "ycb_mug").name == "025_mug"


@pytest.mark.parametrize(
    ("names", "folder", "said"),
    [
        (["025_mug", "ycb_025_mug", *OTHERS], "", r"2 candidates .* \(025_mug\): 025_mug, ycb_025_mug; keep"),
        ([*OTHERS, "026_mug"], "", "no archive or folder of ycb_mug.*025_mug_google_16k.*similar: 026_mug"),
        ([], "", "found: nothing"),
        ([], "gone", "--from .*gone is not a directory"),
    ],
)
def test_what_is_not_found_is_said(tmp_path, catalogue, names, folder, said):
    fill(tmp_path, names)
    refused(said, find_local, tmp_path / folder, catalogue, "ycb_mug")
