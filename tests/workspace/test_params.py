import inspect
import json
import re
import subprocess
import sys
from dataclasses import FrozenInstanceError, asdict, is_dataclass
from datetime import date
from pathlib import Path
from typing import get_args, get_type_hints

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from refusals import refused
from ruamel.yaml import YAML

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.materials import Material
from objectfolder.base.metrics import ssim
from objectfolder.shapes import GENERATORS
from objectfolder.vision.settings import MIN_RESOLUTION
from objectfolder.workspace.check import Selection, check_all, check_entries
from objectfolder.workspace.params import (
    HELD_PARAMS,
    UNSEEN_BY_DVC,
    ObjectEntry,
    Shared,
    check_seen,
    object_entry,
    procedural_entry,
    read,
    settings,
    stage_params,
)
from objectfolder.workspace.presets import default_sections, read_preset
from objectfolder.workspace.stages import (
    BENCHMARKS,
    FIRST_STAGES,
    OBJECT_STAGES,
    ON_DEMAND,
    ROBOT_STAGES,
    SECTIONS,
    check_key,
    section_config,
)

REPOSITORY = Path(__file__).parents[2]
MUG = {
    **{"mesh": "data/objects/mug/mesh.glb", "material": "ceramic", "scale": 0.1},
    **{"up": "y", "wall": None, "bridge": "all"},
}
NONE = {name: [] for name in Selection.model_fields}


@pytest.fixture
def values():
    return default_sections() | {
        "seed": 3,
        "procedural": {},
        "objects": {"mug": dict(MUG)},
        "benchmarks": NONE,
    }


@pytest.fixture
def write(tmp_path, values):
    def write(**changes):
        path = tmp_path / "params.yaml"
        with path.open("w") as stream:
            YAML(typ="safe").dump(values | changes, stream)
        return path

    return write


@pytest.mark.parametrize("samples", [0, 1, 63])
def test_test_views_need_samples_for_two_halves(write, values, samples):
    section = values["render_views"] | {"test_samples": samples}
    with pytest.raises(ObjectFolderError, match=rf"test_samples: .*got {samples}"):
        stage_params(section_config("render_views"), "mug", write(render_views=section))


def test_views_too_small_to_evaluate_are_refused_before_they_are_built(write, values):
    view = np.random.default_rng(0).random((MIN_RESOLUTION, MIN_RESOLUTION, 3))
    assert ssim(view, view) == pytest.approx(1)
    config, section = section_config("render_views"), values["render_views"]
    assert stage_params(config, "mug", write(render_views=section | {"resolution": MIN_RESOLUTION}))
    refused(
        "render_views: resolution is 10, expected at least 11: the SSIM",
        stage_params,
        config,
        "mug",
        write(render_views=section | {"resolution": MIN_RESOLUTION - 1}),
    )


@pytest.mark.parametrize(
    ("key", "reason"),
    [
        *((key, "DVC drops integer keys silently") for key in (7, True)),
        *((key, "keys become file and stage names") for key in ("mug-a", "", "mug\n", None, 1.5)),
        *(("mug.old", "DVC reads a dot as a path"), ("../x", "dot as a path")),
        *(("Mug", "all lower case"), ("2mug", "expected a letter")),
        *((stage, "it is the name of a stage") for stage in ("modal", "generate", "hash_code", "reach")),
    ],
)
def test_a_key_that_is_no_slug_is_refused_with_the_reason(key, reason):
    caught = refused(reason, check_key, key, "params.yaml: objects")
    assert caught.startswith("params.yaml: objects: ")
    assert repr(key) in caught


@given(st.from_regex(r"[a-z][a-z0-9_]*", fullmatch=True))
def test_slugs_are_keys(key):
    if key not in {*FIRST_STAGES, *OBJECT_STAGES, *ON_DEMAND, *BENCHMARKS, *ROBOT_STAGES}:
        assert check_key(key) == key


@given(st.text())
def test_no_other_text_is_a_key(key):
    try:
        assert check_key(key) == key
    except ObjectFolderError:
        return
    assert key.isascii()
    assert key == key.lower()
    assert not set(key) & set(" ./-\n\\")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"scale": 0}, r"scale: .*greater than or equal to 0.0001, got 0"),
        ({"scale": 9e-5}, r"scale: .*greater than or equal to 0.0001, got 9e-05"),
        ({"scale": float("nan")}, r"scale: .*got nan"),
        ({"scale": 1000}, r"scale: .*less than or equal to 100, got 1000"),
        ({"scale": 10**400}, r"scale: "),
        ({"scale": "big"}, r"scale: .*valid number, got 'big'"),
        ({"scale": True}, r"scale: .*got True"),
        ({"scale": None}, r"scale: .*got None"),
        ({"material": 3}, r"material: .*got 3"),
        ({"up": "x"}, r"up: .*'y' or 'z'.*got 'x'"),
        ({"colour": "red"}, r"colour: .*got 'red'"),
        ({"mesh": 5}, r"mesh: .*got 5"),
        (
            {"mesh": "data/objects/die/mesh.glb"},
            r"mesh is 'data/objects/die/mesh.glb', expected a file in data/objects/mug/",
        ),
        ({"mesh": "/etc/passwd"}, r"expected a file in data/objects/mug/"),
    ],
)
def test_a_wrong_field_names_file_field_and_value(write, change, message):
    path = write(objects={"mug": MUG | change})
    caught = refused(message, stage_params, section_config("normalize"), "mug", path)
    assert caught.startswith(f"{path}: objects.mug")


@pytest.mark.parametrize(
    ("section", "old", "new"),
    [("train_audio", "batch", "bach"), ("modal", "max_modes", "maxmodes"), ("objects", "wall", "wal")],
)
def test_a_misspelled_field_is_refused_with_the_nearest_name(write, values, section, old, new):
    fields = {"wall": None, **MUG} if section == "objects" else values[section]
    value = fields[old]
    renamed = {name: other for name, other in fields.items() if name != old} | {new: value}
    path = write(**{section: {"mug": renamed} if section == "objects" else renamed})
    with pytest.raises(ObjectFolderError) as caught:
        stage_params(section_config("modal" if section == "objects" else section), "mug", path)
    message = str(caught.value)
    assert f"{new}: " in message
    assert f", got {value!r}; did you mean {old}?" in message
    assert "got {" not in message


def test_a_setting_that_is_not_written_is_missed_at_any_depth(write, values):
    del values["train_audio"]["sizes"][1]["steps"], values["train_audio"]["batch"]
    with pytest.raises(ObjectFolderError) as caught:
        stage_params(section_config("train_audio"), "mug", write())
    assert "train_audio: sizes.steps: Field required, by default 3400; batch: Field req" in str(caught.value)


def test_a_missing_field_and_an_entry_that_is_none(write):
    entry = {k: v for k, v in MUG.items() if k != "scale"}
    with pytest.raises(ObjectFolderError, match=r"objects\.mug: scale: Field required"):
        stage_params(section_config("normalize"), "mug", write(objects={"mug": entry}))
    with pytest.raises(ObjectFolderError, match=r"objects\.mug: entry: .*got 'steel'"):
        stage_params(section_config("normalize"), "mug", write(objects={"mug": "steel"}))


def test_whole_numbers_and_upper_case_materials_are_taken(values):
    values["objects"]["mug"] |= {"scale": 2, "material": "Steel"}
    entry = object_entry("mug", values)
    assert entry.scale == 2.0
    assert entry.material == "steel"


def test_an_unknown_object_lists_the_known_ones(write):
    with pytest.raises(ObjectFolderError, match=r"no object 'bowl' \(it has mug\); add it"):
        stage_params(section_config("modal"), "bowl", write())
    refused("none yet", stage_params, section_config("modal"), "bowl", write(objects={}))


@pytest.mark.parametrize("name", SECTIONS)
def test_a_section_is_the_dataclass_of_its_code(write, values, name):
    config = section_config(name)
    section = settings(config, values)
    assert type(section) is config
    assert json.loads(json.dumps(asdict(section))) == values[name]
    assert "pydantic" not in getattr(config, "__module__", "")
    params = stage_params(config, "mug", write())
    assert params.settings == section
    assert params.entry == object_entry("mug", values)
    assert (params.seed, params.sensor) == (values["seed"], values["sensor"])


def test_sections_are_frozen(write):
    section = stage_params(section_config("modal"), "mug", write()).settings
    with pytest.raises(FrozenInstanceError):
        section.max_modes = 3


def test_an_unrelated_broken_section_does_not_matter_to_a_stage(write, values):
    path = write(train_vision={"net": "paper"})
    stage_params(section_config("modal"), "mug", path)
    refused(r"train_vision: .*net: ", stage_params, section_config("train_vision"), "mug", path)
    refused(r"train_vision: .*net: ", check_all, read(path), path)


@pytest.mark.parametrize(
    ("section", "field", "value"),
    [
        ("modal", "max_modes", 0),
        ("modal", "max_modes", 1.5),
        ("modal", "max_modes", "many"),
        ("modal", "max_modez", 3),
        ("voxelize", "resolutions", []),
        ("voxelize", "resolutions", [32, "x"]),
        ("voxelize", "resolutions", [33]),
        (
            "modal",
            "fine",
            {"resolutions": [33], "subdivisions": 4, "max_degrees_of_freedom": 9, "max_error": 0.1},
        ),
        ("voxelize", "sdf_resolution", 4),
        ("train_audio", "sizes", []),
        ("train_audio", "sizes", [{"modes": 1}]),
        ("render_views", "train", -1),
        ("train_vision", "table_bits", 40),
        ("encode", "encoder", date(2020, 1, 1)),
    ],
)
def test_a_wrong_value_of_a_section_names_file_section_and_field(write, values, section, field, value):
    path = write(**{section: values[section] | {field: value}})
    caught = refused(field, stage_params, section_config(section), "mug", path)
    assert caught.startswith(f"{path}: {section}: {field}")


@pytest.mark.parametrize("change", [{"seed": -1}, {"seed": "x"}, {"sensor": 3}, {"seed": None}])
def test_shared_values_are_checked(write, change):
    refused(next(iter(change)), stage_params, section_config("render_touch"), "mug", write(**change))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: [", "not valid YAML"),
        ("- 1", "holds list, expected a mapping"),
        ("", "expected a mapping"),
        ("a: 1", "objects must be a mapping"),
        ("objects: {}\nprocedural:\n", "procedural must be a mapping"),
        ("objects: {}\nobjects: {}\nprocedural: {}", "not valid YAML"),
    ],
)
def test_a_file_that_is_not_parameters_is_named(tmp_path, text, message):
    (tmp_path / "params.yaml").write_text(text)
    caught = refused(message, read, tmp_path / "params.yaml")
    assert str(tmp_path / "params.yaml") in caught


def test_no_file(tmp_path):
    message = "run inside an objectfolder workspace, or make one: `objectfolder init DIR`"
    refused(message, read, tmp_path / "params.yaml")


def test_the_audio_net_grows_with_the_number_of_modes(write):
    section = stage_params(section_config("train_audio"), "mug", write()).settings
    small, large = section.sizes
    assert section.size(0) == section.size(small.modes) == small
    assert section.size(small.modes + 1) == section.size(10**6) == large
    assert large.width > small.width


def test_procedural_entries(write):
    path = write(procedural={"cup": {"generator": "mug", "height": 2.0}, "bad": {"height": 1}})
    assert procedural_entry("cup", path) == ("mug", {"height": 2.0})
    refused("procedural has no 'mug'", procedural_entry, "mug", path)
    refused(r"procedural\.bad: generator: Field required", procedural_entry, "bad", path)


OLD = [
    ("die", {"size": 0.16, "fillet": 0.019}, "edge"),
    ("toy", {"kind": "duck", "size": 0.2}, "span"),
    ("appliance", {"size": 0.28}, "span"),
    ("electronics", {"size": 0.6}, "span"),
    ("wrench", {"length": 0.2, "size": 0.017}, "flats"),
]


@pytest.mark.parametrize(("generator", "old", "name"), OLD)
def test_sizes_of_earlier_versions_are_read_with_a_line_that_says_what_to_write(
    write, monkeypatch, caplog, generator, old, name
):
    path = write(procedural={"die": {"generator": generator} | old})
    monkeypatch.chdir(path.parent)
    line = f"procedural.die.size is called {name} now; write {name}: {old['size']}"
    today = {name if field == "size" else field: value for field, value in old.items()}
    assert procedural_entry("die", path) == (generator, today)
    assert [record.message for record in caplog.records] == [f"{path}: {line}"]
    check_entries(read(path), path)
    # `dvc repro` would not see an edit of it; a build gives its stages what it has recorded.
    refused(rf"procedural\.die\.size: DVC ignores.*; write {name}: ", procedural_entry, "die")
    monkeypatch.setenv(HELD_PARAMS, str(path))
    caplog.clear()
    assert procedural_entry("die") == (generator, today)
    assert not caplog.records


@pytest.mark.parametrize("name", UNSEEN_BY_DVC)
@pytest.mark.parametrize(
    "place",
    [("own",), ("modal", "own"), ("procedural", "own"), ("train_audio", "sizes", 0), ("objects", "mug")],
)
def test_names_that_dvc_does_not_see_are_refused_with_the_reason(values, name, place):
    entry = values
    for part in place:
        entry = entry[part] if part != "own" else entry.setdefault(part, {"generator": "mug"})
    entry[name] = 3
    words = re.escape(".".join(map(str, [*place, name])))
    refused(rf"{words}: DVC ignores .* another name", check_entries, values)


def test_no_parameter_has_a_name_that_dvc_does_not_see():
    def fields(config):
        if is_dataclass(config):
            for field, kind in get_type_hints(config).items():
                yield field
                yield from fields(kind)
        for inner in get_args(config):
            yield from fields(inner)

    names = {name for section in SECTIONS for name in fields(section_config(section))}
    assert {"max_modes", "most_features", "branch_depth"} <= names
    names |= {name for function in GENERATORS.values() for name in inspect.signature(function).parameters}
    names |= {*ObjectEntry.model_fields, *Selection.model_fields, *Shared.model_fields, *SECTIONS}
    names |= {*get_type_hints(Material)}
    assert not names & {*UNSEEN_BY_DVC}
    for path in (REPOSITORY / "catalogs").glob("*.yaml"):
        check_seen(YAML(typ="safe").load(path.read_text()), path)


def test_the_projects_own_parameters_are_valid():
    check_all(read(REPOSITORY / "params.yaml"))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"sed": 0}, "params.yaml: 'sed' is not a section; do you mean seed"),
        ({"train_vison": {}}, "'train_vison' is not a section; do you mean train_vision"),
        ({"Seed": {}}, "'Seed' is not a section; do you mean seed"),
        ({"zzz": {}}, "'zzz' is not a section; expected one of objects, "),
        ({"seed": -1}, "seed: Input should be greater than or equal to 0"),
        (
            {"objects": {"modal": MUG}},
            "'modal' is not a valid object key (it is the name of a stage",
        ),
        (
            {"objects": {"mug": MUG | {"material": "gold"}}},
            "objects.mug: material: unknown material 'gold'",
        ),
        (
            {"objects": {"mug": MUG | {"wall": 0.05}}},
            "mug: wall: got 0.05 m, expected less than half",
        ),
        ({"objects": {"mug": MUG | {"wall": 2.0}}}, "objects.mug: wall: got 2 m, expected less than half"),
        ({"procedural": {"cup": {"height": 1}}}, "procedural.cup: generator: Field required"),
        ({"benchmarks": {**NONE, "reach": ["cup"]}}, "benchmarks.reach: cup is not an object"),
    ],
)
def test_entries_alone_are_refused_with_the_message_of_a_whole_check(values, changes, message):
    check_entries(values)
    found = []
    for check in (check_all, check_entries):
        with pytest.raises(ObjectFolderError) as caught:
            check({**values, **changes})
        found.append(str(caught.value))
    assert found[0] == found[1]
    assert message in found[0]


@pytest.mark.parametrize("section", SECTIONS)
def test_a_section_that_is_missing_is_named_by_both_checks(values, section):
    del values[section]
    config = section_config(section)
    for check in (check_all, check_entries, lambda values: settings(config, values)):
        refused(f"lacks section '{section}'; run `objectfolder preset", check, values)


def test_entries_are_checked_without_the_modules_of_the_stages():
    code = (
        "import sys; from objectfolder.workspace import params; from objectfolder.workspace.check import *;"
        "check_entries(params.read()); print(*sys.modules)"
    )
    ran = subprocess.run(
        [sys.executable, "-c", code], cwd=REPOSITORY, capture_output=True, text=True, check=True
    )
    assert {"torch", "scipy", "mitsuba", "igl"}.isdisjoint(ran.stdout.split())


def test_an_encoder_whose_changes_a_build_would_not_see_is_refused(values):
    values["encode"]["encoder"] = "mine.py:small"
    check_all(values)  # `objectfolder bench` without a preset takes it from here
    values["benchmarks"] = {stage: [] for stage in Selection.model_fields} | {"recognize": ["seen"]}
    refused(r"encode.encoder is 'mine.py:small'.*bench --encoder", check_all, values)


def test_only_the_presets_of_the_paper_damp_as_the_paper():
    presets = ("quick", "laptop", "standard", "faithful", "faithful-small")
    laws = [read_preset(name, REPOSITORY)[0]["modal"]["damping"] for name in presets]
    assert laws == ["loss_factor"] * 3 + ["rayleigh"] * 2


@pytest.mark.parametrize(
    ("mass", "said"),
    [
        *((mass, f"mass: Input should be greater than 0, got {float(mass)}") for mass in (0, -0.118)),
        *((mass, "mass: Input should be a valid number, got") for mass in ("heavy", True, [0.1])),
        *((mass, "mass: Input should be a finite number, got") for mass in (float("nan"), float("inf"))),
        (
            40.0,
            r"mass is 40 kg, in the cube around it of 1000 cm³ .* 4e\+04 kg/m³, .*: 0\.04 for 40 g, or check",
        ),
    ],
)
def test_a_wrong_mass_is_refused_with_the_object(values, mass, said):
    values["objects"]["mug"]["mass"] = mass
    assert refused(said, check_all, values).startswith("params.yaml: objects.mug: ")


def test_a_mass_may_be_absent_or_null_and_is_written_only_if_known(values):
    for said, written in (({}, {}), ({"mass": None}, {}), ({"mass": 1}, {"mass": 1.0})):
        values["objects"]["mug"] = MUG | said
        check_all(values)
        assert object_entry("mug", values).model_dump() == MUG | written
