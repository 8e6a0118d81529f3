"""The catalogues of the paper's and of the real objects, and finding objects in it by name."""

import csv
import hashlib
import json
import re
from collections import Counter
from io import StringIO
from pathlib import Path

import pytest
from hostile import WORDS
from own_workspace import ROOT
from refusals import refused
from rich.console import Console

from objectfolder.base.materials import material_names
from objectfolder.base.text import visible
from objectfolder.base.yamlfile import read_yaml
from objectfolder.hub.fetch.catalogue import read_catalogue, select_objects
from objectfolder.hub.fetch.report import print_catalogue
from objectfolder.hub.fetch.run import source_text
from objectfolder.hub.release.entries import CATEGORIES
from objectfolder.hub.release.notices import read_notice
from objectfolder.workspace import params, stages

PATH = ROOT / "catalogs/objectfolder1.yaml"
REAL = ROOT / "catalogs/real.yaml"
TABLE = ROOT.parent / "shared/reference/objectfolder1_objects.csv"
SIZE_SLIPS = {"ycb_mug": "0.082", "ycb_medium_clamp": "0.115", "ycb_nine_hole_peg_test": "1.2"}


def test_the_objects_are_the_hundred_of_the_paper(catalogue):
    entries = catalogue.objects.values()
    assert [entry.id for entry in entries] == list(range(1, 101))
    assert len({entry.name for entry in entries}) == 100
    # Counted in the published table.
    materials = {"ceramic": 19, "glass": 2, "wood": 21, "plastic": 11, "iron": 6, "polycarbonate": 24}
    assert Counter(entry.material for entry in entries) == materials | {"steel": 17}
    assert Counter(entry.source for entry in entries) == {"polyhaven": 20, "ycb": 28, "gso": 52}


def test_every_entry_can_be_added_beside_those_of_other_catalogues(catalogue):
    for key, entry in catalogue.objects.items():
        assert stages.check_key(key).startswith(f"{entry.source}_")
        assert entry.material in material_names()
        assert 0.01 < entry.scale < 2.5
    for other in (ROOT / "catalogs").glob("*.yaml"):
        if other not in (PATH, REAL):  # the second is of the first
            assert not set(catalogue.objects) & set(params.read(other)["objects"])


def test_names_materials_and_sizes_are_the_published_ones_but_for_noted_slips(catalogue):
    if not TABLE.exists():
        pytest.skip("the published table is not here")
    with TABLE.open() as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == 100
    for (key, entry), row in zip(catalogue.objects.items(), rows):
        published = int(row["id"]), row["name"], row["material"].lower()
        assert (entry.id, entry.name, entry.material) == published
        assert ("3dmodelhaven" in row["source"]) == (entry.source == "polyhaven")
        assert ("GoogleResearch" in row["source"]) == (entry.source == "gso")
        assert float(SIZE_SLIPS.get(key, entry.scale)) == float(row["scale_m"])


def test_a_note_says_the_published_size_and_ours(catalogue):
    noted = {key: entry for key, entry in catalogue.objects.items() if entry.note}
    assert set(noted) == set(SIZE_SLIPS)
    for key, entry in noted.items():
        assert f"published {SIZE_SLIPS[key]} " in entry.note
        assert entry.note.endswith(f"{entry.scale:g}")


def test_the_objects_of_ycb_have_their_published_masses(catalogue):
    """As dm_robotics and others copied them from the table of Calli et al., g."""
    weighed = {entry.name: entry.mass for entry in catalogue.objects.values() if entry.mass is not None}
    assert {*weighed} == {entry.name for entry in catalogue.objects.values() if entry.source == "ycb"}
    cups = dict(zip("abcdefghij", (13, 14, 17, 19, 21, 26, 28, 31, 35, 38)))
    published = {f"065-{cup}_cups": grams for cup, grams in cups.items()} | {
        **{"019_pitcher_base": 178, "024_bowl": 147, "025_mug": 118, "029_plate": 279, "030_fork": 34},
        **{"031_spoon": 30, "032_knife": 31, "033_spatula": 51.5, "036_wood_block": 729, "038_padlock": 304},
        **{"040_large_marker": 15.8, "042_adjustable_wrench": 252, "050_medium_clamp": 59, "062_dice": 5.2},
        **{"051_large_clamp": 125, "052_extra_large_clamp": 202, "071_nine_hole_peg_test": 1435},
        "072-a_toy_airplane": 570,
    }
    assert weighed == pytest.approx({name: grams / 1000 for name, grams in published.items()}, rel=1e-12)


@pytest.mark.parametrize("mass", ["0", "-1", "heavy", ".nan"])
def test_a_catalogue_with_a_wrong_mass_is_refused(tmp_path, mass):
    path = tmp_path / "bad.yaml"
    path.write_text(PATH.read_text().replace("mass: 0.118", f"mass: {mass}"))
    refused(r"bad\.yaml is not a catalogue .*: objects\.ycb_mug\.mass: Input should be", read_catalogue, path)


def test_addresses_have_the_ids(catalogue):
    assert catalogue.url("ycb_mug").endswith("/google/025_mug_google_16k.tgz")
    assert catalogue.url("gso_bunny_racer").endswith("/GoogleResearch/models/BUNNY_RACER.zip")
    assert catalogue.url("polyhaven_barrel_01") == "https://api.polyhaven.com/files/Barrel_01"
    for key in catalogue.objects:
        assert catalogue.url(key).startswith("https://")
        assert "{" not in catalogue.url(key) + catalogue.page(key)


def test_the_notice_names_licence_and_authors(catalogue):
    text = source_text("ycb_mug", catalogue, catalogue.url("ycb_mug"))
    facts = ("025_mug", "CC BY 4.0", "Calli et al.", "Gao et al., CoRL 2021", "published 0.082", "renamed")
    facts += ("Mass: 0.118 kg; Calli et al., Benchmarking in Manipulation Research",)
    assert all(fact in text for fact in facts)
    other = source_text("polyhaven_lantern", catalogue, "x")
    assert "CC0 1.0" in other
    assert "Mass" not in other


@pytest.mark.parametrize("text", WORDS)
def test_no_word_begins_a_line_of_the_notice(catalogue, tmp_path, text):
    """Such as a licence before that of the source."""
    entry = catalogue.objects["ycb_mug"].model_copy(update={"name": text, "note": text, "model": "m"})
    source = catalogue.sources["ycb"].model_copy(update={"title": text, "attribution": text})
    held = {"objects": {"ycb_mug": entry}, "sources": {"ycb": source}}
    notice = source_text("ycb_mug", catalogue.model_copy(update=held), f"the archive {text}")
    (tmp_path / "SOURCE.txt").write_text(notice, encoding="utf-8")
    assert notice.count("\n") == source_text("ycb_mug", catalogue, "x").count("\n")
    assert all(line.isprintable() for line in notice.splitlines())
    found = read_notice(tmp_path / "mesh.glb")
    assert (found.licence, found.attribution) == (source.licence, visible(text).strip())


@pytest.mark.parametrize(
    ("field", "address"),
    [
        ("url", "https://me:secret@a.b/{model}"),
        ("url", "ftp://a.b/{model}"),
        ("url", "https:///{model}"),
        ("page", "javascript:alert(1)"),
        ("page", "https://a.b/\x1b[2J"),
    ],
)
def test_addresses_of_a_catalogue_are_those_of_the_web(tmp_path, field, address):
    values = read_yaml(PATH)
    values["sources"]["ycb"][field] = address
    path = tmp_path / "catalogue.yaml"
    path.write_text(json.dumps(values), encoding="utf-8")
    assert refused(r"of source ycb is .*, expected .*http://", read_catalogue, path).isprintable()


def test_objects_are_found_by_key_and_name_in_any_case(catalogue):
    wanted = ["ycb_mug", "024_BOWL", "065-a cups", "bunny_racer", "025_mug"]
    assert select_objects(catalogue, wanted) == ["ycb_mug", "ycb_bowl", "ycb_cup_a", "gso_bunny_racer"]


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("mug", "; similar: .*ycb_mug"),
        ("ycb_mugg", "; similar: .*ycb_mug"),
        ("Barrel_1", "; similar: .*polyhaven_barrel_01"),
        ("racer", "; similar: .*gso_chicken"),
        ("", "; --list shows"),
        ("zzzzqqqq", "; --list shows"),
    ],
)
def test_an_unknown_name_brings_near_ones_if_there_are(catalogue, name, said):
    refused(rf"no object {name!r} in the catalogue{said}.*", select_objects, catalogue, ["ycb_bowl", name])


def test_an_address_can_be_replaced(catalogue):
    changed = read_catalogue(PATH, ["gso=http://mirror/{model}/it.zip"])
    assert changed.url("gso_bunny_racer") == "http://mirror/BUNNY_RACER/it.zip"
    assert changed.url("ycb_mug") == catalogue.url("ycb_mug")


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ("nowhere=https://x/{model}", "SOURCE one of polyhaven, ycb, gso"),
        ("https://x/{model}", "SOURCE one of"),
        ("ycb=https://x/mug.tgz", "{model} in place of the object's id"),
        ("ycb=file:///{model}", "use --from DIR"),
    ],
)
def test_a_bad_address_is_refused(option, message):
    refused(message, read_catalogue, PATH, [option])


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("material: steel", "material: jelly", "objects.polyhaven_barrel_01.material: .*jelly"),
        ("source: gso", "source: moon", "source is 'moon', expected one of polyhaven, ycb, gso"),
        ("scale: 0.88", "scale: -1", "objects.polyhaven_barrel_01.scale"),
        ("id: 2,", "colour: red,", "objects.polyhaven_barrel_01.(id|colour)"),
        ("polyhaven_barrel_01:", "Barrel 1:", "'Barrel 1' is not a valid object key"),
        ("objects:", "objects: [", "not valid YAML"),
    ],
)
def test_a_bad_catalogue_is_refused_and_the_place_named(tmp_path, old, new, message):
    path = tmp_path / "bad.yaml"
    path.write_text(PATH.read_text().replace(old, new))
    assert str(path) in refused(message, read_catalogue, path)


def test_a_catalogue_of_another_kind_is_refused():
    starters = ROOT / "catalogs/starter.yaml"
    refused(r"starter\.yaml is not a catalogue of published objects", read_catalogue, starters)
    refused(r"nothing\.yaml does not exist", read_catalogue, Path("nothing.yaml"))


def test_the_real_hundred_is_of_the_paper_but_for_39(catalogue):
    real = read_catalogue(REAL)
    own = {key: entry for key, entry in real.objects.items() if key not in catalogue.objects}
    assert (len(real.objects), len(own)) == (100, 39)
    assert len({entry.source_model for entry in real.objects.values()}) == 100
    for key, entry in real.objects.items():
        assert entry.category in CATEGORIES
        if key not in own:
            published = catalogue.objects[key]
            assert entry.scale == pytest.approx(published.scale, rel=0.03) or f"{entry.scale:g}" in entry.note
            kept = {field: getattr(published, field) for field in ("scale", "note", "category")}
            assert entry.model_copy(update=kept) == published
    assert not any(entry.id for entry in own.values())
    assert real.sources == catalogue.sources


def test_version_1_of_the_real_hundred_never_changes():
    real = read_catalogue(REAL)
    objects = {key: entry.model_dump(exclude={"note"}) for key, entry in real.objects.items()}
    text = json.dumps([real.version, objects], sort_keys=True)
    digest = "6fbe0635992efdd8705ab7f429857284a4eaf35b5111a1b6dcafbe31874a10d1"
    message = "version 1 is frozen: put other objects into another catalogue"
    assert hashlib.sha256(text.encode()).hexdigest() == digest, message


def test_the_notice_of_an_object_that_the_paper_lacks_does_not_name_the_paper():
    real = read_catalogue(REAL)
    text = source_text("ycb_golf_ball", real, "x")
    assert "Calli et al." in text
    assert "Material and size: objectfolder, real objects, version 1" in text
    assert not re.search("ObjectFolder 1.0|Gao", text)
    assert "object 21 of ObjectFolder 1.0" in source_text("ycb_pitcher", real, "x")


@pytest.mark.parametrize(("path", "category"), [(PATH, []), (REAL, ["kitchen"])])
def test_a_list_has_the_categories_that_a_catalogue_names(path, category):
    console = Console(file=StringIO(), width=200)
    print_catalogue(read_catalogue(path), {"gso_frypan"}, console)
    lines = [line.split() for line in console.file.getvalue().splitlines()]
    assert ["✓", "gso_frypan", "steel", "0.356", "m", *category, "Chefmate_8_Frypan"] in lines


def extending(folder, text):
    """Write a catalogue that extends the paper's; return its path."""
    (folder / PATH.name).write_bytes(PATH.read_bytes())
    (folder / "mine.yaml").write_text(text)
    return folder / "mine.yaml"


def test_an_extended_catalogue_gives_what_is_not_said(tmp_path, catalogue):
    own = "{name: X, material: glass, scale: 1, source: ycb}"
    text = f"""extends: objectfolder1.yaml
sources: {{gso: {{title: Mirror}}}}
objects: {{ycb_bowl: {{}}, ycb_mug: {{scale: 2}}, own: {own}}}"""
    found = read_catalogue(extending(tmp_path, text))
    assert list(found.objects) == ["ycb_bowl", "ycb_mug", "own"]
    assert found.objects["ycb_bowl"] == catalogue.objects["ycb_bowl"]
    assert found.objects["ycb_mug"] == catalogue.objects["ycb_mug"].model_copy(update={"scale": 2})
    gso = catalogue.sources["gso"].model_copy(update={"title": "Mirror"})
    assert found.sources == catalogue.sources | {"gso": gso}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("extends: ../objectfolder1.yaml", r"extends is '../objectfolder1.yaml', expected a file name"),
        ("extends: [a]", r"extends is \['a'\], expected a file name"),
        ("extends: none.yaml", r"none.yaml does not exist; .*mine.yaml extends it"),
        ("extends: mine.yaml", r"mine.yaml is not a catalogue .*: .*extends: Extra inputs"),
        ("extends: objectfolder1.yaml", "objects: Field required"),
        ("extends: objectfolder1.yaml\nobjects: [1]", "objects: Input should be"),
        ("extends: objectfolder1.yaml\nobjects: {ycb_mug: 1}", "objects.ycb_mug: Input should be"),
        ("extends: objectfolder1.yaml\nsources: 1\nobjects: {}", "sources: Input should be"),
    ],
)
def test_what_cannot_be_extended_is_said(tmp_path, text, message):
    refused(message, read_catalogue, extending(tmp_path, text))
