"""Released files as Object Files: `convert`, the command, and what is asked of them."""

import copy
import logging
import re
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import released_files as released
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from refusals import refused
from typer.testing import CliRunner

from objectfolder import ObjectFile
from objectfolder.base.errors import ObjectFolderError
from objectfolder.cli import app
from objectfolder.hub.importer import convert as converter
from objectfolder.hub.importer import nets
from objectfolder.hub.importer.checkpoint import ReleasedDict, read_released
from objectfolder.hub.importer.convert import ImportOptions, convert
from objectfolder.nets.positional import append_octaves
from objectfolder.nets.released_network import Frame
from objectfolder.objectfile.query_files import sample_presses
from objectfolder.report.certificate import file_checks
from objectfolder.touch.profiles import available_profiles, load_profile
from objectfolder.vision.cameras import Intrinsics

BOUNDS = np.array([[-0.09, -0.12, -0.07], [0.11, 0.08, 0.13]])
CAMERAS = np.array([[0.0, -2.5, 0.2], [1.5, 1.5, 1.3]])
LIGHT = np.array([0.0, 0.6, 0.8])
POINTS = np.array([[0.05, -0.03, 0.07], [-0.02, 0.01, 0.1], [0.1, -0.07, 0.02]])
SMALL = Intrinsics(7, 5, 8.0)
SENSOR = load_profile("gelsight_r15")


@pytest.fixture
def file(tmp_path):
    def write(values, **options):
        path = tmp_path / "25" / "ObjectFile.pth"
        path.parent.mkdir(exist_ok=True)
        torch.save(values, path)
        return convert(path, ImportOptions(**options))

    return write


@pytest.fixture
def quick_gel(monkeypatch):
    """Look at fewer contacts for the untouched gel."""
    monkeypatch.setattr("objectfolder.hub.importer.nets._PROBES", 1)


def saved(obj, tmp_path):
    obj.save(tmp_path / "out.safetensors")
    return ObjectFile.load(tmp_path / "out.safetensors")


@pytest.mark.parametrize("order", [nets.by_octave, nets.by_number])
def test_channels_are_put_in_our_order(rng, order):
    x = rng.normal(size=(4, 3))
    theirs = {nets.by_octave: released.encode, nets.by_number: released.kilo_encode}[order](x, 5)
    ours = append_octaves(torch.from_numpy(x), 5, 1.0).numpy()
    np.testing.assert_allclose(theirs[:, order(3, 5)], ours, rtol=1e-12)


def test_a_file_of_1_0_answers_all_three_questions(file, tmp_path):
    obj = saved(file(released.released_1(1), bounds=BOUNDS, material="ceramic"), tmp_path)
    obj.check()
    assert (obj.key, obj.material) == ("object_25", "ceramic")
    assert obj.scale == pytest.approx(0.2)
    assert obj.header["imported"] == {"release": "ObjectFolder 1.0", "notes": []}
    assert obj.view(CAMERAS, LIGHT, intrinsics=SMALL).shape == (2, 5, 7, 3)
    sound = obj.impact(POINTS[:1], [[1.0, 2.0, -1.0]])
    assert sound.shape == (1, 32000)
    assert sound.any()
    np.testing.assert_allclose(obj.impact(POINTS[:1], [[2.0, 4.0, -2.0]]), 2 * sound, rtol=1e-4, atol=1e-5)
    assert obj.touch(POINTS).shape == (3, 160, 120, 3)
    refused("holds no geometry", obj.sample_surface, 3)
    refused("trained at depth", obj.touch, POINTS, depth=0.002)


def test_a_file_of_2_0_answers_all_three_questions(file, tmp_path):
    obj = saved(file(released.released_2(1)), tmp_path)
    obj.check()
    assert obj.header["imported"] == {"release": "ObjectFolder 2.0", "notes": []}
    assert obj.scale == pytest.approx(0.19)
    assert obj.view(CAMERAS, LIGHT, intrinsics=SMALL).shape == (2, 5, 7, 3)
    assert obj.frequencies.shape == (7,)
    assert obj.impact(POINTS, np.eye(3), sample_rate=44100, duration=0.1).shape == (3, 4410)
    refused("own material and size only", obj.impact, POINTS, np.eye(3), material="steel")
    unknown = r"striker touches is not known.*give contact_time instead"
    refused(unknown, obj.impact, POINTS, np.eye(3), striker="finger")
    assert obj.impact(POINTS, np.eye(3), duration=0.1, contact_time=1e-3).any()
    felt = obj.press(POINTS, depth=[0.0005, 0.001, 0.002], tilt=0.1, azimuth=[0, 1, 2])
    assert felt.images.shape == (3, 320, 240, 3)
    assert felt.height.shape == felt.mask.shape == (3, 320, 240)
    refused(r"depth: row 0 is 0\.003; the released net was trained on", obj.touch, POINTS, depth=0.003)
    refused("tilt: row 0", obj.touch, POINTS, tilt=0.5)
    refused("angle: row 0", obj.touch, POINTS, angle=0.5)
    maps = obj.depth_maps(POINTS, depth=[0.0005, 0.001, 0.002], tilt=0.1, azimuth=[0, 1, 2])
    net = obj._parts.touch.net
    depths = np.array([0.0005, 0.001, 0.002])
    exact = net.depth_maps(POINTS / obj.scale, depths, np.full(3, 0.1), np.arange(3))
    np.testing.assert_array_equal(maps, exact)
    assert obj.touch(POINTS[:1], sensor="digit").shape == (1, 160, 120, 3)


def test_an_answer_depends_on_its_own_row_only(file):
    """Unlike the original's, whose coordinates are scaled by the extremes of the batch."""
    first, second = (file(released.released_1(2), bounds=BOUNDS), file(released.released_2(2)))
    for obj in (first, second):
        touches, views = obj.touch(POINTS), obj.view(CAMERAS, LIGHT, intrinsics=SMALL)
        for i in range(3):
            np.testing.assert_array_equal(obj.touch(POINTS[[i]])[0], touches[i])
        for i in range(2):
            np.testing.assert_array_equal(obj.view(CAMERAS[[i]], LIGHT, intrinsics=SMALL)[0], views[i])
    many = np.tile(POINTS, (7, 1))
    together = second.impact(many, np.tile(np.eye(3), (7, 1)))
    for i in range(3):
        np.testing.assert_array_equal(second.impact(POINTS[i], np.eye(3)[i])[0], together[i + 18])
    sound = first.impact(POINTS[:2], np.eye(3)[:2], duration=0.1)
    np.testing.assert_array_equal(first.impact(POINTS[1], np.eye(3)[1], duration=0.1)[0], sound[1])


def test_kiloosf_keeps_only_the_nets_that_are_asked(file, tmp_path):
    values = released.released_kilo(3)
    vision = values["VisionNet"]
    occupied = vision["occupancy_grid"].view(9, 8, 8)
    occupied[:] = False
    occupied[4:8, 1:3, 5:] = True
    full = copy.deepcopy(values)
    full["VisionNet"]["occupancy_grid"] = None
    obj, whole = saved(file(values), tmp_path), file(full)
    assert whole.header["vision"]["net"]["voxels"] == [3, 2, 4]
    assert len(obj.tensors["vision.cells"]) < len(whole.tensors["vision.cells"]) == 24
    picture = obj.render(CAMERAS[0], LIGHT, intrinsics=Intrinsics(24, 24, 30.0))
    assert 0 < (picture.alpha > 0).mean() < 0.2
    assert obj.header["audio"] if "audio" in obj.header else obj.header["imported"]["notes"]


def test_what_cannot_be_read_is_left_out_with_a_warning(file, caplog):
    values = released.released_2(1)
    del values["VisionNet"]["cfg"]
    with caplog.at_level(logging.WARNING):
        obj = file(values)
    assert "vision is left out" in caplog.text
    assert "VisionNet.cfg is missing" in caplog.text
    assert [part for part in ("vision", "audio", "touch") if part in obj.header] == ["audio", "touch"]
    refused("holds no vision", obj.view, CAMERAS, LIGHT)
    obj = file(released.released_1(1))  # without bounds
    assert "pass --bounds or --mesh" in obj.header["imported"]["notes"][0]
    assert "touch" not in obj.header
    refused("nothing could be imported", file, {"VisionNet": {}})


KILO = {
    **{"late_feed_direction": False, "refeed_position_index": 1, "num_frequencies_light": 3, "near": 5},
    **{"num_hidden_layers": 3, "fixed_resolution": [3, 2], "global_domain_max": [0.6, -0.7, 0.6]},
    **{"nonlinearity": "sine", "num_importance_samples_per_ray": 8, "use_global_coordinates": True},
    **{"occupancy": {"resolution": [9, 8, 9]}, "blender_white_background": False},
}


@pytest.mark.parametrize("key", sorted(KILO))
def test_settings_that_are_not_known_are_errors_that_name_them(file, key):
    values = released.released_kilo(3)
    values["VisionNet"]["cfg"][key] = KILO[key]
    refused("VisionNet", file, values)


def leaves(values, path=()):
    for key, value in values.items():
        if isinstance(value, dict):
            yield from leaves(value, (*path, key))
        else:
            yield (*path, key)


#: What no part reads, or has a default.
UNUSED = ("global_step", "optimizer_state_dict", "views_linears", "perturb", "raw_noise_std", "model_type")
UNUSED += ("direction_layer_size", "hidden_layer_size", "llff_lindisp", "no_color_sigmoid")
UNUSED += ("refeed_position", "threshold")


def without(values, path):
    """Nested dictionaries less one entry."""
    name, *rest = path
    return {k: without(v, rest) if k == name else v for k, v in values.items() if rest or k != name}


@pytest.mark.parametrize("make", [released.released_1, released.released_2, released.released_kilo])
def test_every_missing_key_is_named(tmp_path, quick_gel, make):
    torch.save(make(1, 4), tmp_path / "file.pth")
    whole, first = read_released(tmp_path / "file.pth").values, make is released.released_1
    readers = {
        "VisionNet": (nets.nerf_net if first else nets.configured_net, ()),
        "AudioNet": (nets.spectrogram_net if first else nets.gains_net, (Frame(),)),
        "TouchNet": (nets.image_net, (Frame(), BOUNDS)) if first else (nets.depth_net, (Frame(), SENSOR)),
    }
    needed = [p for p in leaves(whole) if not any(name in key for key in p for name in UNUSED)]
    assert len(needed) > 20
    for path in needed:
        if path[-1] == "occupancy_grid":
            continue  # without, every net is asked
        part = ReleasedDict("file.pth", "", without(whole, path)).part(path[0])
        read, arguments = readers[path[0]]
        named = re.escape(".".join(path).replace("module.", ""))
        refused(named, read, ReleasedDict(tmp_path / "file.pth", path[0], part.values), *arguments)


def test_points_are_those_of_the_released_file_or_of_the_centred_mesh(file, tmp_path, monkeypatch):
    """With a mesh, the object frame is centred and metric, and points are snapped."""
    monkeypatch.setattr(converter, "RESOLUTION", 48)
    trimesh = pytest.importorskip("trimesh")
    mesh = trimesh.creation.box(bounds=BOUNDS * 100)  # the file's coordinates are centimetres
    mesh.export(tmp_path / "box.ply")
    values = released.released_2(4)
    for part in (values["AudioNet"]["normalizer"], values["TouchNet"]):
        part["xyz_min"], part["xyz_max"] = BOUNDS[0] * 100, BOUNDS[1] * 100
    plain = file(values)
    centred = saved(file(values, mesh=tmp_path / "box.ply", scale=0.2), tmp_path)
    place = np.array([[11.0, 1.0, 2.0]])  # on the box
    assert plain.scale == pytest.approx(20)
    np.testing.assert_allclose(centred.bounds, [[-0.1] * 3, [0.1] * 3], atol=2e-3)
    shapes = centred.mode_shapes(place / 100 - BOUNDS.mean(0))
    np.testing.assert_allclose(shapes, plain.mode_shapes(place), rtol=2e-2, atol=2e-2 * np.abs(shapes).max())
    refused("off the surface", centred.mode_shapes, [[0.0, 0.0, 0.0]])
    assert len(centred.sample_surface(5)) == 5


def test_points_outside_the_bounds_of_the_net_are_refused(file, quick_gel):
    second, first = file(released.released_2(1)), file(released.released_1(1), bounds=BOUNDS)
    box = {"second": "[-0.08, -0.08, -0.08] to [0.11, 0.11, 0.11]", "first": "[-0.12, -0.12, -0.12] to [0.13"}
    points = np.array([[0.0, 0.0, 0.0], [50.0, -30.0, 70.0]])  # of the second, in millimetres
    for bounds, ask, *more in (
        (box["second"], second.mode_shapes),
        (box["second"], second.impact, [[0.0, 0.0, 1.0]] * 2),
        (box["second"], second.touch, 0.001),
        (box["second"], second.depth_maps, 0.001),
        (box["first"], first.touch),
    ):
        error = refused(None, ask, points, *more)
        assert f"row 1 at [50.0, -30.0, 70.0] m is outside the net's bounds, {bounds}" in error
        assert "points are in the released file's coordinates, metres" in error
    for end, outside in ((-0.08, -1), (0.11, 1)):  # 2 % of 0.19 m: 0.0038
        assert second.mode_shapes([[end + outside * 0.0037, 0, 0]]).shape == (1, 3, 7)
        for axis in np.eye(3):
            refused(r"by more than 0\.0038 m", second.mode_shapes, [axis * (end + outside * 0.0039)])
    assert second.mode_shapes([[0.2, 0, 0]], tolerance=0.5).shape == (1, 3, 7)


@pytest.mark.parametrize("pair", [True, False])
def test_a_mesh_is_as_large_as_the_file_says(file, tmp_path, quick_gel, monkeypatch, pair):
    monkeypatch.setattr(converter, "RESOLUTION", 48)
    trimesh = pytest.importorskip("trimesh")
    values, bounds = released.released_2(4, 4), np.array([[-0.08, 0.0, 0.0], [0.02, 0.05, 0.11]])
    if not pair:
        for part in (values["AudioNet"]["normalizer"], values["TouchNet"]):
            part["xyz_min"], part["xyz_max"] = bounds

    def converted(factor, **options):
        trimesh.creation.box(bounds=bounds * factor).export(tmp_path / "box.ply")
        return file(values, mesh=tmp_path / "box.ply", **options)

    # One pair for all axes spans the numbers of all of them.
    found, expected = ("coordinates span 190", "0.19") if pair else ("longest side is 110", "0.11")
    message = rf"box\.ply: its {found}, the file's stored bounds say {expected}; .* give --scale"
    refused(message, converted, 1000)
    for factor in (0.89, 1.11):
        refused("stored bounds", converted, factor)
    assert converted(1.09).scale == pytest.approx(1.09 * 0.11)
    assert converted(1000, scale=0.11).scale == 0.11
    refused(r"bounds are given beside the mesh .*box\.ply", converted, 1, bounds=bounds)


def test_a_size_that_nothing_tells_is_said_to_be_assumed(file, caplog):
    note = "longest side not known (1 m assumed): give --scale or --bounds"
    for values in (released.released_1(1, 4), released.released_kilo(3)):
        with caplog.at_level(logging.WARNING):
            obj = file(values)
        assert obj.scale == 1
        assert obj.header["imported"]["notes"][-1] == note
        assert note in caplog.messages
        for options in ({"scale": 1.0}, {"bounds": BOUNDS}):
            assert note not in file(values, **options).header["imported"]["notes"]
    assert file(released.released_2(1, 4)).header["imported"]["notes"] == []


def test_cropping_changes_nothing_inside(file):
    values = released.released_1(5, density=5.0)
    whole, cropped = file(values), file(values, crop=10.0)
    seen = [obj.view(CAMERAS, LIGHT, intrinsics=SMALL) for obj in (whole, cropped)]
    np.testing.assert_array_equal(*seen)
    small = file(values, crop=0.3).render(CAMERAS[0], LIGHT, intrinsics=Intrinsics(40, 40, 55.0))
    seen = small.alpha[0] > 0
    assert 0.02 < seen.mean() < 0.2  # a cube of 0.6, 2.5 away: (0.6 / 2.5 * 55)^2 of 1600 pixels
    depth = small.depth[0][seen] / small.rgba.dtype.type(file(values).scale)
    assert 2.0 < depth.min() <= depth.max() < 3.0


def test_the_gel_of_the_released_code_is_taken_as_it_is(file, tmp_path):
    heights = np.full((120, 160), 8.0, np.float32)
    np.save(tmp_path / "depth_bg.npy", heights)
    obj = file(released.released_2(1), gel=tmp_path / "depth_bg.npy")
    np.testing.assert_allclose(obj.tensors["touch.untouched"], 0.04 - 8 * 0.0001245, rtol=1e-6)


def test_contact_is_where_the_depth_map_is_past_the_gel(file):
    """A net that answers one depth everywhere: a flat object 1 mm into the middle of the sensor's image."""
    values = released.released_2(1)
    state = values["TouchNet"]["model_state_dict"]
    state["module.output_linear.weight"].zero_()
    state["module.output_linear.bias"].fill_((0.038 - 0.0339) / (0.04 - 0.0339))
    obj = file(values, sensor="digit")
    obj.tensors["touch.untouched"] = np.full((120, 160), 0.039, np.float32)
    felt = ObjectFile(obj.header, obj.tensors).press(POINTS[:1], depth=0.001)
    assert felt.max_penetration[0] == pytest.approx(0.001, abs=1e-6)
    rows = np.flatnonzero(felt.height[0].max(1) > 0)
    assert 0 < rows[0] <= 159 - rows[-1] + 1  # the depth map is lower than the image of the DIGIT
    assert (felt.height[0, :, 60] > 0).sum() * 0.0254 / 160 == pytest.approx(120 * 0.0001245, rel=0.05)


@pytest.mark.parametrize("sensor", available_profiles())
def test_sampled_presses_are_answered_whatever_the_sensor(file, quick_gel, sensor):
    obj, given = file(released.released_2(1, 4), sensor=sensor), load_profile(sensor)
    for presses in (sample_presses(obj, 100), sample_presses(obj, 100, sensor=given)):
        tilt, _, depth = presses.T
        obj._parts.touch.net.require(depth, tilt)
    assert obj.press_range() == (max(given.press_depth[0], 0.0005), min(given.press_depth[1], 0.002))


def test_a_sensor_that_is_pressed_less_is_pressed_as_the_net_knows(file, quick_gel):
    obj = file(released.released_2(1, 4))
    light = replace(load_profile("digit"), press_depth=(0.0001, 0.0003))
    assert obj.press_range(light) == (0.0005, 0.002)


def test_an_imported_file_with_a_surface_has_a_certificate(file, quick_gel, brick, monkeypatch):
    monkeypatch.setattr("objectfolder.report.certificate.STRIKES", 1)
    obj = file(released.released_2(1, 4), sensor="gelsight_mini")
    for name in ("vision", "audio"):
        del obj.header[name]
    header = obj.header | {"geometry": brick.header["geometry"], "scale": brick.scale}
    distances = {"geometry.distances": brick.tensors["geometry.distances"]}
    checks = file_checks(ObjectFile(header, dict(obj.tensors) | distances))
    assert "Deeper presses touch more" in [check.name for check in checks]


def test_the_command_writes_an_object_file(tmp_path):
    source, out, written = tmp_path / "ObjectFile.pth", tmp_path / "bowl.safetensors", []
    torch.save(released.released_1(1), source)
    command = ["import", str(source), str(out), "--key", "bowl", "--bounds", *map(str, BOUNDS.ravel())]
    for _ in range(2):
        ran = CliRunner().invoke(app, command)
        assert ran.exit_code == 0, ran.output
        assert "ObjectFolder 1.0" in ran.output
        written.append(out.read_bytes())
    assert written[0] == written[1]
    assert ObjectFile.load(out).key == "bowl"
    assert "released_image" in CliRunner().invoke(app, ["info", str(out)]).output


def test_no_other_file_is_overwritten(tmp_path):
    source, other = tmp_path / "ObjectFile.pth", tmp_path / "other.pth"
    torch.save(released.released_2(1), source)
    other.write_bytes(b"another release")
    ran = CliRunner().invoke(app, ["import", str(source), str(other)])
    assert "such as bowl.safetensors" in str(ran.exception)
    assert other.read_bytes() == b"another release"


def test_options_that_make_no_sense_are_errors(file):
    values = released.released_1(1, 4)
    refused("expected xmin", file, values, bounds=BOUNDS[::-1])
    refused("longest side", file, values, scale=-1.0)
    for key, rest in (("../x", ""), ("Bowl 1", ", then letters"), ("", ""), ("k" * 101, ".* at most 100$")):
        refused(f"^key is '{key}', expected a letter{rest}", file, values, key=key)
    refused("^material is 'm+', .* at most 100 characters$", file, values, material="m" * 101)
    for name in ("", " "):
        refused(f"^material is '{name}', expected a name such as steel", file, values, material=name)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--sensor", "gelsite"], "unknown sensor profile 'gelsite'"),
        (["--gel", "depth_bg.npy"], r"\(160, 120\), expected .*: heights of shape \(120, 160\)"),
        (["--gel", "low.npy"], r"low.npy has 119 rows; expected heights of shape \(120, 160\)"),
        (["--gel", "absent.npy"], "absent.npy does not exist; expected a .npy file"),
        (["--gel", "ObjectFile.pth"], "^ObjectFile.pth is not a .npy file of numbers: (?!.*pickle)"),
        (["--gel", "objects.npy"], "^objects.npy holds object, expected real numbers$"),
        (["--gel", "other.bin"], "^other.bin is not a .npy file of numbers: (?!.*pickle)"),
        (["--crop", "0"], "crop is 0.0, expected half the side"),
        (["--crop", "-0.6"], "crop is -0.6, expected half the side"),
        (["--crop", "nan"], "crop is nan, expected a finite number"),
        (["--crop", "inf"], "crop is inf, expected a finite number"),
    ],
)
def test_wrong_options_write_nothing(tmp_path, monkeypatch, options, message):
    monkeypatch.chdir(tmp_path)
    np.save("depth_bg.npy", np.full((160, 120), 8.0, np.float32))
    np.save("low.npy", np.full((119, 160), 8.0, np.float32))
    np.save("objects.npy", np.full((120, 160), None), allow_pickle=True)
    Path("other.bin").write_bytes(b"\x08" + bytes(100))
    torch.save(released.released_2(1), "ObjectFile.pth")
    ran = CliRunner().invoke(app, ["import", "ObjectFile.pth", "out.safetensors", *options])
    assert isinstance(ran.exception, ObjectFolderError)
    assert re.search(message, str(ran.exception))
    assert not (tmp_path / "out.safetensors").exists()


MUTANTS = [None, 0, -1.5, 1 << 70, "text", [], {}, [1, 2, 3], float("nan"), float("inf"), np.float64(1e300)]
MUTANTS += [np.zeros(0), np.full(3, np.nan), np.zeros((2, 2), complex), torch.zeros(()), torch.zeros(3, 0)]
MUTANTS += [torch.full((4, 63), torch.inf), torch.arange(5), torch.ones(4, 4, dtype=torch.complex64)]
MUTANTS += [torch.ones(7, dtype=torch.float64)]
MUTANTS += [torch.zeros(1).expand(1 << 40), torch.zeros(1).expand(4, 1 << 30)]


@given(st.data())
@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_other_structure_is_an_error_or_an_object_file(file, quick_gel, data):
    make = data.draw(st.sampled_from([released.released_1, released.released_2, released.released_kilo]))
    values = make(0, 4)
    paths = sorted(leaves(values))
    for _ in range(data.draw(st.integers(1, 3))):
        path = data.draw(st.sampled_from(paths))
        place = values
        for key in path[: data.draw(st.integers(1, len(path))) - 1]:
            place = place[key] if isinstance(place.get(key), dict) else place
        changed = data.draw(st.sampled_from(sorted(place))) if place else "x"
        place[changed] = data.draw(st.sampled_from(MUTANTS))
    with suppress(ObjectFolderError):
        obj = file(values, bounds=BOUNDS)
        obj.check()
        if "vision" in obj.header:
            assert np.isfinite(obj.view(CAMERAS[:1], LIGHT, intrinsics=Intrinsics(2, 2, 3.0))).all()
