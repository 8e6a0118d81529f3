"""Licence and attribution of fetched objects, in all that a release writes of them."""

import csv
import json
import re
from pathlib import Path

import pytest
from own_workspace import ROOT
from publisher import addresses, gso, polyhaven, ycb
from refusals import refused
from ruamel.yaml import YAML

from objectfolder import Dataset
from objectfolder.base.io import file_digest, write_json
from objectfolder.base.yamlfile import read_yaml
from objectfolder.cli import app
from objectfolder.hub.fetch.catalogue import read_catalogue
from objectfolder.hub.fetch.run import FetchStatus, fetch_all, source_text
from objectfolder.hub.release.notices import LICENCE_URLS, licence_address, licence_name, read_notice
from objectfolder.objectfile.file import ObjectFile
from objectfolder.objectfile.samples import sample_path
from objectfolder.workspace import params
from objectfolder.workspace.layout import Build

CATALOGUES = ("objectfolder1.yaml", "real.yaml")
CC_BY, CC0 = (
    "https://creativecommons.org/licenses/by/4.0/",
    "https://creativecommons.org/publicdomain/zero/1.0/",
)
REDISTRIBUTABLE = {"CC-BY-4.0": CC_BY, "CC0-1.0": CC0}
CHANGES = (
    "the mesh is renamed; files that it does not refer to are omitted; "
    "converted to an implicit representation by objectfolder"
)
#: Title, source, licence and attribution of an object of each publisher.
FETCHED = {
    "ycb_mug": (
        "025_mug, object 23 of ObjectFolder 1.0",
        "YCB Object and Model Set, https://www.ycbbenchmarks.com/object-models/",
        "CC-BY-4.0",
        "YCB Object and Model Set, Calli et al., IEEE Robotics and Automation Magazine 22(3), 2015",
    ),
    "gso_frypan": (
        "Chefmate_8_Frypan, object 87 of ObjectFolder 1.0",
        "Google Scanned Objects, https://app.gazebosim.org/GoogleResearch/fuel/models/Chefmate_8_Frypan",
        "CC-BY-4.0",
        "Google Scanned Objects, (c) 2020 Google LLC, Downs et al., ICRA 2022",
    ),
    "polyhaven_barrel_01": (
        "Barrel_01, object 2 of ObjectFolder 1.0",
        "Poly Haven (formerly 3D Model Haven), https://polyhaven.com/a/Barrel_01",
        "CC0-1.0",
        "Powered by Poly Haven (https://polyhaven.com)",
    ),
}
CATEGORIES = {"ycb_mug": "kitchen", "gso_frypan": "kitchen", "polyhaven_barrel_01": "household"}


def stand_in(key, **audio):
    """The bell in place of an Object File that a build would write."""
    file = ObjectFile.load(sample_path("bell"))
    header = file.header
    header |= {"key": key, "audio": header["audio"] | audio}
    Build(key).dir.mkdir(parents=True)
    ObjectFile(header, file.tensors).save(Build(key).object_file)
    write_json(Build(key).metrics, {"file_sha256": file_digest(Build(key).object_file)})
    return file.material, file.scale


@pytest.fixture
def fetched(workspace, publisher):
    """A workspace with an object of each publisher, fetched and built, and the bell, which is generated."""
    publisher.pages |= {"/025_mug_google_16k.tgz": ycb("025_mug"), "/Chefmate_8_Frypan.zip": gso()}
    publisher.pages |= polyhaven(publisher, "Barrel_01")
    results = fetch_all(FETCHED, read_catalogue(Path("catalogs/real.yaml"), addresses(publisher)))
    assert [result.status for result in results] == [FetchStatus.ADDED] * 3
    values = read_yaml(Path("params.yaml"))
    for key in FETCHED:
        material, scale = stand_in(key, **({"uncertain": True} if key == "ycb_mug" else {}))
        values["objects"][key] |= {"material": material, "scale": scale}
        values["objects"][key].pop("mass", None)
    stand_in("bell")
    with Path("params.yaml").open("w") as stream:
        YAML(typ="safe").dump(values, stream)
    assert {*FETCHED} < {*params.read()["objects"]}
    return workspace


def release(*arguments):
    options = ("--no-site", "--catalogue", "catalogs/real.yaml", "--creator", "A", "--url", "https://a.test")
    app(["release", *arguments, *options, "out"], standalone_mode=False)


def test_every_object_has_its_licence_and_attribution_in_all_places(fetched, capsys):
    release("--licence", "MIT")
    out, dataset = Path("out"), Dataset("out")
    assert {*dataset.keys} == {*FETCHED, "bell"}
    rows = {row["key"]: row for row in csv.DictReader((out / "objects.csv").read_text().splitlines())}
    described = json.loads((out / "croissant.json").read_text())
    files = {file["name"]: file for file in described["distribution"]}
    assert described["license"] == sorted([CC_BY, CC0, LICENCE_URLS["MIT"]])
    pages = [(out / name).read_text().replace("\\", "") for name in ("README.md", "DATASHEET.md")]
    assert "license: [cc-by-4.0, cc0-1.0, mit]\n" in pages[0]
    for key, (title, source, licence, attribution) in FETCHED.items():
        url = REDISTRIBUTABLE[licence]
        said = {"title": title, "source": source, "licence": licence, "licence_url": url}
        said |= {"attribution": attribution, "changes": CHANGES, "category": CATEGORIES[key]}
        entry = dataset.entry(key)
        assert {name: getattr(entry, name) for name in said} == said
        assert {name: rows[key][name] for name in said} == said
        assert entry.uncertain == dataset[key].header["audio"].get("uncertain", 0) == (key == "ycb_mug")
        assert (files[key]["license"], files[key]["creditText"]) == (url, attribution)
        notice = (out / f"licences/{key}.txt").read_text()
        assert notice == Path(f"data/objects/{key}/SOURCE.txt").read_text()
        assert f"\nAttribution: {attribution}\n" in notice
        assert re.search(rf"^Licence: .* \({url}\)$", notice, re.MULTILINE)
        for page in pages:
            assert f"- {attribution}; {licence} ({url}): {key}. Changes: {CHANGES}.\n" in page
    bell = dataset.entry("bell")
    assert (bell.licence, bell.licence_url, bell.category) == ("MIT", LICENCE_URLS["MIT"], "household")
    assert (bell.attribution, bell.changes, bell.title, bell.uncertain) == ("", "", "", 0)
    assert not (out / "licences/bell.txt").exists()
    kept = " ".join(capsys.readouterr().out.split())
    said = "polyhaven_barrel_01 (CC0-1.0); ycb_mug, gso_frypan (CC-BY-4.0)"
    assert f"note: --licence MIT does not apply where SOURCE.txt states another: {said}" in kept


def test_a_licence_for_all_that_is_of_none_is_refused(fetched):
    said = r"CC0-1.0 applies to none of these objects: .* gso_frypan \(CC-BY-4.0\); leave the option out"
    refused(said, release, "ycb_mug", "gso_frypan", "--licence", "CC0-1.0")
    assert not Path("out").exists()
    release("ycb_mug", "gso_frypan", "--licence", "CC BY 4.0", "--category", "ycb_mug=mugs")
    assert Dataset("out").entry("ycb_mug").category == "mugs"


@pytest.mark.parametrize("name", CATALOGUES)
def test_every_mesh_of_the_catalogues_may_be_redistributed_and_names_its_authors(name, tmp_path):
    catalogue = read_catalogue(ROOT / "catalogs" / name)
    assert len(catalogue.objects) == 100
    for key in catalogue.objects:
        source = catalogue.source(key)
        (tmp_path / "SOURCE.txt").write_text(source_text(key, catalogue, catalogue.url(key)))
        notice = read_notice(tmp_path / "mesh.obj")
        assert REDISTRIBUTABLE[licence_name(notice.licence)] == licence_address(notice.licence)
        assert notice.licence.endswith(f"({licence_address(notice.licence)})")
        assert notice.attribution == source.attribution != ""
        assert notice.source == f"{source.title}, {catalogue.page(key)}"
        assert notice.title.startswith(catalogue.objects[key].name)
