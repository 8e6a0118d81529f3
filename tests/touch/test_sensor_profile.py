import hashlib
import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import refused

from objectfolder.base.errors import ObjectFolderError
from objectfolder.touch.profiles import RESIDUAL_TERMS, SensorProfile, available_profiles, load_profile

DIGIT = load_profile("digit")
POSITIVE = (
    *("height", "width", "vertical_fov_deg", "camera_to_gel", "elastomer_thickness", "max_indentation"),
    *("gel_dome_radius", "young_modulus", "roughness", "gamma", "gain", "background_falloff"),
)
NON_NEGATIVE = (
    *("gel_curvature", "poisson_ratio", "ambient", "albedo", "metallic"),
    *("slope_smoothing", "image_smoothing", "noise_std"),
)


def test_digit_is_the_sensor_of_the_paper():
    assert (DIGIT.height, DIGIT.width) == (160, 120)
    # 2 · 22 mm · tan 30° over 160 rows
    assert DIGIT.pixel_pitch == pytest.approx(0.15877e-3, rel=1e-4)


@pytest.mark.parametrize("name", available_profiles())
def test_every_profile_says_its_own_name_and_where_its_numbers_are_from(name):
    profile = load_profile(name)
    assert profile.name == name
    assert len(profile.source) > 80
    assert bool(profile.background_image) == name.endswith("_real")  # photographs
    assert profile.noise_std == 0


@pytest.mark.parametrize(("name", "pitch"), [("gelsight_mini", 0.0634e-3), ("gelsight_r15", 0.0877e-3)])
def test_gelsights_have_the_published_pixel_size(name, pitch):
    assert load_profile(name).pixel_pitch == pytest.approx(pitch, rel=1e-4)


def test_tacto_digit_is_tactos():
    tacto = load_profile("tacto_digit")
    for angle, light in zip((30, 150, 270), tacto.lights):
        y, z = 0.02 * np.cos(np.radians(angle)), 0.02 * np.sin(np.radians(angle))
        assert light.position == pytest.approx((0.005, y, z), abs=2e-6)
        assert light.intensity == pytest.approx(1 / 255, rel=2e-4)
    assert tacto.gel == "rigid"
    assert tacto.image_smoothing / tacto.pixel_pitch == pytest.approx(1.4, rel=1e-4)  # 7 x 7 pixels
    assert DIGIT.gel == "soft"


def test_background_image_is_found_beside_the_profile_of_a_path(tmp_path):
    path, picture = tmp_path / "mine.yaml", str(tmp_path / "rest.png")
    path.write_text(json.dumps(DIGIT.to_dict() | {"name": "mine", "background_image": "rest.png"}))
    assert load_profile(path) == replace(DIGIT, name="mine", background_image=picture)


def test_another_background_image_than_the_profile_knows_is_refused(tmp_path):
    """The pipeline tracks the profile: a picture that changes must change it."""
    (tmp_path / "rest.png").write_bytes(b"a picture")
    digest = hashlib.sha256(b"a picture").hexdigest()
    path = tmp_path / "mine.yaml"
    values = DIGIT.to_dict() | {"background_image": "rest.png", "background_sha256": digest}
    path.write_text(json.dumps(values))
    assert load_profile(path).background_sha256 == digest
    (tmp_path / "rest.png").write_bytes(b"another")
    other = hashlib.sha256(b"another").hexdigest()
    refused(rf"mine\.yaml: background_sha256 .*rest\.png.*: {other}", load_profile, path)


def test_round_trip_through_json_is_exact():
    assert SensorProfile.from_dict(json.loads(json.dumps(DIGIT.to_dict()))) == DIGIT
    assert hash(SensorProfile.from_dict(DIGIT.to_dict())) == hash(DIGIT)


NO_FILE = r"^sensor profile '.*ml': there is no such file; .* digit, "


@pytest.mark.parametrize(
    ("name", "text", "reason"),
    [
        ("gelsite", None, r"'gelsite'.*digit"),
        *((name, None, NO_FILE) for name in ("no.yaml", "a/no.yml", "x" * 300 + ".yaml", "folder.yaml")),
        *(("broken.yaml", text, r"broken\.yaml") for text in ("name: [", "", "- 1", "name: a\nname: b")),
    ],
)
def test_what_is_no_profile_is_named(tmp_path, name, text, reason):
    path = tmp_path / name
    (tmp_path / "folder.yaml").mkdir()
    if text is not None:
        path.write_text(text)
    refused(reason, load_profile, path if path.suffix else name)


@settings(deadline=None)
@given(st.sampled_from(sorted(DIGIT.to_dict())))
def test_missing_field_is_named(name):
    values = DIGIT.to_dict()
    del values[name]
    refused(f"lacks {name}", SensorProfile.from_dict, values)


def test_unknown_fields_are_named():
    refused("unknown fields lense", SensorProfile.from_dict, DIGIT.to_dict() | {"lense": 1})
    lights = [DIGIT.to_dict()["lights"][0] | {"power": 1}]
    refused(r"lights.*unknown fields power", SensorProfile.from_dict, DIGIT.to_dict() | {"lights": lights})
    newer = DIGIT.to_dict() | {"lights": [light | {"power": 1} for light in DIGIT.to_dict()["lights"]]}
    assert SensorProfile.from_dict(newer | {"lense": 1}, stored=True) == DIGIT


@settings(deadline=None)
@given(st.sampled_from(POSITIVE), st.floats(max_value=0) | st.just(float("nan")))
def test_positive_fields_reject_the_rest(name, value):
    refused(name, SensorProfile.from_dict, DIGIT.to_dict() | {name: value})


@settings(deadline=None)
@given(st.sampled_from(NON_NEGATIVE), st.floats(max_value=-1e-300) | st.just(float("inf")))
def test_non_negative_fields_reject_the_rest(name, value):
    refused(name, SensorProfile.from_dict, DIGIT.to_dict() | {name: value})


LIGHT = {"position": [0, 0, 0], "color": [0, 0, 1], "intensity": 1}
WRONG = {
    **{
        "name": [3],
        "height": [160.5, True, 1],
        "gamma": ["2.2"],
        "vertical_fov_deg": [180],
        "roughness": [1.5],
    },
    **{"gel": ["firm", 1], "poisson_ratio": [0.5], "gel_dome_radius": [0.006], "background_image": [3]},
    **{"slope_smoothing": [0.0048], "image_smoothing": [0.0048, 1.0]},  # of 19.1 mm seen
    "background_color": [[0.1, 0.2], [0.1, 0.2, 3]],
    "press_depth": [[0.002, 0.001], [0.001, 0.1], [0.001]],
    **{"elastomer_thickness": [0.03], "max_indentation": [0.01]},
    "lights": [[], [3], [LIGHT | {"color": [0, 0, 2]}], [LIGHT | {"intensity": 0}]],
    "residual": [((1.0, 2.0),) * 3, ((1.0,) * RESIDUAL_TERMS,) * 2],
}


@pytest.mark.parametrize(
    ("name", "value"), [(name, value) for name, values in WRONG.items() for value in values]
)
def test_wrong_value_is_named(name, value):
    refused(f"{name}.* (must be|expected) ", SensorProfile.from_dict, DIGIT.to_dict() | {name: value})


def test_a_field_of_view_narrower_than_the_gel_is_thick_is_refused():
    """Its borders would be a thousand times as wide as the picture."""
    narrow = {"vertical_fov_deg": 0.01, "slope_smoothing": 0, "image_smoothing": 0}
    with pytest.raises(ObjectFolderError, match=r"elastomer_thickness = .* the picture's shorter side"):
        SensorProfile.from_dict(DIGIT.to_dict() | narrow)
