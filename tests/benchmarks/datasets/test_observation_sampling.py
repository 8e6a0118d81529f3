import errno
import json
import logging
import shutil
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from brick import with_images
from folders import contents
from refusals import refused

from objectfolder.base import disk as space
from objectfolder.base.errors import ObjectFolderError
from objectfolder.benchmarks.datasets import sampling
from objectfolder.benchmarks.datasets.observations import Observations
from objectfolder.benchmarks.datasets.samples import object_digest
from objectfolder.benchmarks.datasets.sampling import (
    ask,
    draw_queries,
    is_sampled,
    observation_request,
    sample_observations,
)
from objectfolder.benchmarks.datasets.settings import ObserveConfig
from objectfolder.benchmarks.run import load_object_files
from objectfolder.objectfile.file import ObjectFile
from objectfolder.touch.profiles import load_profile
from objectfolder.workspace.code_digests import code_digest

COUNT, SIDE = 10, 16
WANTED = ObserveConfig(observations=COUNT, resolution=SIDE)
SENSES = ("vision", "audio", "touch")


@pytest.fixture(scope="module")
def sampled(brick, tmp_path_factory):
    folder = tmp_path_factory.mktemp("observations")
    sample_observations(brick, WANTED, 7, folder)
    return folder


def load(folder, name):
    return np.load(folder / f"{name}.npy", allow_pickle=False)


@pytest.fixture
def change_answers(monkeypatch):
    """Lets a function change answers, given their modality and which are empty, or fail."""
    answer = sampling.ask

    def by(change):
        def ask(file, queries, modality, resolution):
            answers = answer(file, queries, modality, resolution)
            if len(queries["touch_depth"]) > 1:  # more than the question how large an image is
                return change(modality, *answers) or answers
            return answers

        monkeypatch.setattr(sampling, "ask", ask)

    return by


@pytest.fixture
def asked(change_answers):
    """Function that begins to list the modalities that are asked for."""

    def begin():
        found = []
        change_answers(lambda modality, *answers: found.append(modality))
        return found

    return begin


def test_a_record_never_vouches_for_the_array_of_another_request(brick, tmp_path, monkeypatch):
    sample_observations(brick, WANTED, 0, tmp_path)
    before, write = contents(tmp_path), sampling.write_json

    def killed(path, value):
        if path.name == "vision.json":
            raise KeyboardInterrupt
        write(path, value)

    monkeypatch.setattr(sampling, "write_json", killed)
    with pytest.raises(KeyboardInterrupt):
        sample_observations(brick, WANTED, 1, tmp_path)
    monkeypatch.undo()
    sample_observations(brick, WANTED, 0, tmp_path)
    assert contents(tmp_path) == before


def test_observations_are_what_the_object_file_answers(brick, sampled):
    queries = dict(np.load(sampled / "queries.npz", allow_pickle=False))
    vision, audio, touch = (load(sampled, name) for name in SENSES)
    view = brick.view(queries["vision_camera"], queries["vision_light"], SIDE)
    assert (vision == (view * 255).round()).all()
    assert (audio == brick.impact(queries["audio_point"], queries["audio_force"], contact_time=0.0)).all()
    assert (touch == brick.touch(queries["touch_point"], queries["touch_depth"])).all()
    assert [a.dtype for a in (vision, audio, touch)] == [np.uint8, np.float32, np.uint8]
    assert [a.shape for a in (vision, audio, touch)] == [(10, 16, 16, 3), (10, 32000), (10, 160, 120, 3)]


def test_record_says_what_was_drawn(brick, sampled):
    record = json.loads((sampled / "observations.json").read_text())
    arrays = record.pop("arrays")
    assert record == {
        **{"version": 1, "code": code_digest(sample_observations), "object_sha256": object_digest(brick)},
        **{"key": "brick", "material": "plastic", "scale": 0.1, "sensor": "digit"},
        **{"count": COUNT, "resolution": SIDE, "sample_rate": 16000, "seed": 7},
    }
    shapes = {"vision": [10, 16, 16, 3], "audio": [10, 32000], "touch": [10, 160, 120, 3]}
    assert {name: array["shape"] for name, array in arrays.items()} == shapes
    assert [array["empty"] for array in arrays.values()] == [0, 0, 0]


def test_other_code_samples_again(brick, sampled, monkeypatch):
    assert is_sampled(observation_request(brick, WANTED, 7), sampled)
    monkeypatch.setattr(sampling, "code_digest", lambda function: "other")
    assert not is_sampled(observation_request(brick, WANTED, 7), sampled)


def test_queries_are_drawn_as_the_paper_draws_them(brick):
    queries = draw_queries(brick, 200, 0)
    np.testing.assert_allclose(np.linalg.norm(queries["vision_camera"], axis=1), 2.5)
    np.testing.assert_allclose(np.linalg.norm(queries["vision_light"], axis=1), 1)
    for name in ("audio_point", "touch_point"):
        assert (brick.nearest(queries[name])[1] < 0.005 * brick.scale).all()  # edges of its grid
    impulse = np.linalg.norm(queries["audio_force"], axis=1)
    assert impulse.min() >= 0.1
    assert impulse.max() <= 1
    # Log-uniform: the median is the geometric mean of the ends, and its deviation 1.25 log(10) / sqrt(12 n).
    assert abs(np.log10(np.median(impulse)) + 0.5) < 4 * 1.25 / np.sqrt(12 * 200)
    low, high = load_profile("digit").press_depth
    depth = queries["touch_depth"]
    assert low <= depth.min() < low + 0.05 * (high - low)
    assert high - 0.05 * (high - low) < depth.max() <= high


def test_forces_push_into_the_object_in_every_direction(brick):
    queries = draw_queries(brick, 200, 0)
    force = queries["audio_force"] / np.linalg.norm(queries["audio_force"], axis=1, keepdims=True)
    inside = queries["audio_point"] + 1e-3 * force
    sides = np.array([1.0, 0.6, 0.3]) / 2 * brick.scale
    # Grazing strikes at edges may leave through the next face; all others go in.
    assert (np.abs(inside) < sides).all(1).mean() > 0.95
    normal = np.abs(queries["audio_point"]) > sides - 1e-4
    faces = normal.sum(1) == 1
    along = np.abs(force[faces][normal[faces]])
    # Uniform over the half sphere: the component along the normal is uniform over 0 to 1.
    assert abs(along.mean() - 0.5) < 4 / np.sqrt(12 * faces.sum())


def test_rows_depend_on_the_seed_and_their_number_not_on_the_count(brick):
    few, many, other = draw_queries(brick, 10, 0), draw_queries(brick, 30, 0), draw_queries(brick, 10, 1)
    for name in few:
        assert (few[name] == many[name][:10]).all()
        assert (few[name] != other[name]).any()
        assert len(np.unique(many[name], axis=0)) == 30


def test_complete_folder_is_left_alone(brick, sampled, asked):
    before, found = contents(sampled), asked()
    times = {path: path.stat().st_mtime_ns for path in sampled.iterdir()}
    sample_observations(brick, WANTED, 7, sampled)
    assert found == []
    assert contents(sampled) == before
    assert times == {path: path.stat().st_mtime_ns for path in sampled.iterdir()}


def test_of_two_calls_at_once_one_samples_and_both_give_the_same_bytes(brick, sampled, tmp_path, asked):
    found, folder = asked(), tmp_path / "deep" / "folder"
    with ThreadPoolExecutor(2) as pool:
        for call in [pool.submit(sample_observations, brick, WANTED, 7, folder) for _ in range(2)]:
            call.result()
    assert len(found) == 3 * COUNT // 10
    assert contents(folder) == contents(sampled)


FULL, FAILED = OSError(errno.ENOSPC, "No space left"), ObjectFolderError("out of tune")
BLOCK, FROM_AUDIO = "brick: audio observations 0 to 9: ", ["audio", "touch"]


@pytest.mark.parametrize(
    ("failing", "error", "message", "left"),
    [
        ("audio", KeyboardInterrupt, None, FROM_AUDIO),
        ("touch", KeyboardInterrupt, None, ["touch"]),
        ("audio", FULL, "no space in {} to write .*/audio.npy: ", FROM_AUDIO),
        ("audio", FAILED, f"{BLOCK}out of tune", FROM_AUDIO),
        ("audio", np.nan, f"{BLOCK}values are not finite", FROM_AUDIO),
    ],
)
def test_what_breaks_off_keeps_what_is_complete_and_goes_on(
    brick, sampled, tmp_path, change_answers, asked, failing, error, message, left
):
    def stop(modality, answers, empty):
        if modality == failing and error is np.nan:
            answers[3, 5] = error
        elif modality == failing:
            raise error

    change_answers(stop)
    expected = KeyboardInterrupt if message is None else ObjectFolderError
    with pytest.raises(expected, match=message and message.format(tmp_path)):
        sample_observations(brick, WANTED, 7, tmp_path)
    kept = [f"{name}.{ending}" for name in SENSES[: -len(left)] for ending in ("json", "npy")]
    begun = ["ObjectFile.safetensors", "queries.npz", "relief.npy"]
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([*begun, *kept])
    found = asked()
    sample_observations(brick, WANTED, 7, tmp_path)
    assert found == left
    assert contents(tmp_path) == contents(sampled)


@pytest.mark.parametrize("name", ["touch.npy", "touch.json"])
@pytest.mark.parametrize("damage", [lambda data: data[:-1], lambda data: b"", None])
def test_what_is_damaged_or_gone_is_made_again(brick, sampled, tmp_path, asked, name, damage):
    for path in sampled.iterdir():
        data = path.read_bytes()
        if path.name == name:
            data = damage and damage(data)
        if data is not None:
            (tmp_path / path.name).write_bytes(data)
    found = asked()
    sample_observations(brick, WANTED, 7, tmp_path)
    # One newline less at the end of a JSON file is no damage.
    assert found == ([] if name == "touch.json" and damage and damage(b"ab") else ["touch"])
    for name in ("touch.npy", "observations.json"):
        assert (tmp_path / name).read_bytes() == (sampled / name).read_bytes()


@pytest.mark.parametrize("other", [{"count": 20}, {"resolution": 8}, {"seed": 8}, {"scale": 0.2}], ids=str)
def test_folder_of_another_request_is_redone(brick, sampled, tmp_path, asked, other):
    shutil.copytree(sampled, tmp_path, dirs_exist_ok=True)
    found, arguments = asked(), {"count": COUNT, "resolution": SIDE, "seed": 7} | other
    file = ObjectFile(brick.header | {"scale": arguments.pop("scale", 0.1)}, dict(brick.tensors))
    wanted = ObserveConfig(observations=arguments["count"], resolution=arguments["resolution"])
    sample_observations(file, wanted, arguments["seed"], tmp_path)
    assert set(found) == set(SENSES)
    record = json.loads((tmp_path / "observations.json").read_text())
    expected = arguments | {"scale": file.scale, "object_sha256": object_digest(file)}
    assert {name: record[name] for name in expected} == expected
    changed = (tmp_path / "touch.npy").read_bytes() != (sampled / "touch.npy").read_bytes()
    assert changed != ("resolution" in other)


def test_digest_is_of_the_content_and_not_of_the_place(brick, brick_path, tmp_path):
    ObjectFile.load(brick_path).save(tmp_path / "copy.safetensors")
    assert object_digest(ObjectFile.load(tmp_path / "copy.safetensors")) == object_digest(brick)
    name = sorted(brick.tensors)[0]
    changed = np.array(brick.tensors[name])
    changed.reshape(-1)[0] += 1
    assert object_digest(ObjectFile(brick.header, {**brick.tensors, name: changed})) != object_digest(brick)


@pytest.mark.parametrize("part", ["geometry", "vision", "audio", "touch"])
def test_object_file_that_lacks_a_part_is_refused(brick, tmp_path, part):
    header = {name: value for name, value in brick.header.items() if name != part}
    with pytest.raises(ObjectFolderError, match=f"brick: the Object File holds no {part}; benchmarks"):
        sample_observations(ObjectFile(header, dict(brick.tensors)), WANTED, 7, tmp_path / "folder")
    assert not (tmp_path / "folder").exists()


@pytest.mark.parametrize(("count", "resolution", "message"), [(15, 8, "15 obser"), (10, 0, "views of 0 pix")])
def test_wrong_numbers_are_refused(brick, tmp_path, count, resolution, message):
    wanted = ObserveConfig(observations=count, resolution=resolution)
    refused(message, sample_observations, brick, wanted, 7, tmp_path)


def test_small_disk_is_refused_before_any_work(brick, tmp_path, monkeypatch):
    needed = 10 * (16 * 16 * 3 + 32000 * 4 + 160 * 120 * 3)
    usage = space.shutil.disk_usage(tmp_path)
    monkeypatch.setattr(space.shutil, "disk_usage", lambda path: usage._replace(free=needed - 1))
    folder = tmp_path / "folder"
    message = f"brick: observations: no space in {folder}: at least {needed:,} bytes needed, {needed - 1:,} f"
    refused(message, sample_observations, brick, WANTED, 7, folder)
    assert not list(folder.iterdir())


def test_observations_that_show_nothing_are_counted(brick):
    queries = {name: values[:2] for name, values in draw_queries(brick, 10, 0).items()}
    queries["audio_force"] = np.array([[0, 0, 0], [0, 0, 0.5]])
    queries["touch_depth"] = np.array([0.001, 0.0])
    queries["vision_camera"] = np.array([[0, 0, 2.5], [0, 0, 1e3]])
    assert ask(brick, queries, "audio", SIDE)[1].tolist() == [True, False]
    assert ask(brick, queries, "vision", 4)[1].tolist() == [False, True]
    empty = ask(brick, queries, "touch", SIDE)[1]
    assert empty.tolist() == (~brick.press(queries["touch_point"], [0.001, 0]).mask.any((1, 2))).tolist()
    assert not empty[0]


def test_net_that_knows_one_press_is_asked_for_that(brick, tmp_path):
    file = with_images(brick, 0.0012, 0.3)
    sample_observations(file, WANTED, 7, tmp_path)
    assert (np.load(tmp_path / "queries.npz", allow_pickle=False)["touch_depth"] == 0.0012).all()
    assert load(tmp_path, "touch").shape == (10, 6, 4, 3)


def test_presses_that_miss_are_known_by_the_bare_gel(brick, tmp_path, change_answers, asked):
    def miss_once(modality, answers, empty):
        if modality == "touch":
            answers[0] = brick.sensor_background

    change_answers(miss_once)
    sample_observations(brick, WANTED, 7, tmp_path)
    assert Observations({"brick": tmp_path}).untouched(np.array([3, 0, 9, 0])).tolist() == [False, True] * 2
    (tmp_path / "untouched.npy").unlink()  # as in observations of before
    found = asked()
    sample_observations(brick, WANTED, 7, tmp_path)
    assert found == []
    assert Observations({"brick": tmp_path}).untouched(np.array([0, 1])).tolist() == [True, False]


def test_silent_object_is_named(brick, tmp_path, change_answers, caplog):
    change_answers(lambda name, answers, empty: (0 * answers, empty | True) if name == "audio" else None)
    with caplog.at_level(logging.WARNING):
        sample_observations(brick, WANTED, 7, tmp_path)
    assert "brick: 10 of 10 observations of audio are empty" in caplog.text
    assert json.loads((tmp_path / "observations.json").read_text())["arrays"]["audio"]["empty"] == 10


def test_observations_do_not_depend_on_how_many_follow(brick, sampled, tmp_path):
    heard = []
    sample_observations(
        brick,
        replace(WANTED, observations=20),
        7,
        tmp_path,
        lambda modality, done: heard.append((modality, done)),
    )
    assert heard == [(name, done) for name in SENSES for done in (10, 20)]
    for name in SENSES:
        assert (load(tmp_path, name)[:10] == load(sampled, name)).all()


def test_an_interrupted_sampling_leaves_no_second_file_of_the_object(
    brick, brick_path, tmp_path, change_answers
):
    def interrupted(*given):
        raise KeyboardInterrupt

    shutil.copy(brick_path, tmp_path / "ObjectFile.safetensors")
    change_answers(interrupted)
    with pytest.raises(KeyboardInterrupt):
        sample_observations(brick, WANTED, 7, tmp_path / "observations" / "brick")
    assert len(list(tmp_path.rglob("ObjectFile.safetensors"))) == 2
    assert load_object_files([tmp_path])["brick"].path == tmp_path / "ObjectFile.safetensors"


def test_a_named_folder_without_an_object_file_is_refused(brick, tmp_path):
    (tmp_path / "mug").mkdir()
    (tmp_path / "brick").mkdir()
    brick.save(tmp_path / "brick" / "ObjectFile.safetensors")
    with pytest.raises(ObjectFolderError, match=r"no Object Files in .*mug: no ObjectFile\.safetensors in"):
        load_object_files([tmp_path / "brick", tmp_path / "mug"])
    assert list(load_object_files([tmp_path])) == ["brick"]


def test_presses_of_one_depth_change_touches_alone(brick, sampled, tmp_path, asked):
    shutil.copytree(sampled, tmp_path, dirs_exist_ok=True)
    found, wanted = asked(), replace(WANTED, depth=0.001)
    sample_observations(brick, wanted, 7, tmp_path)
    assert found == ["touch"]
    assert is_sampled(observation_request(brick, wanted, 7), tmp_path)
    queries = dict(np.load(tmp_path / "queries.npz", allow_pickle=False))
    assert (load(tmp_path, "touch") == brick.touch(queries["touch_point"], 0.001)).all()
    assert (
        queries["touch_point"] == np.load(sampled / "queries.npz", allow_pickle=False)["touch_point"]
    ).all()
    sample_observations(brick, WANTED, 7, tmp_path)
    assert found == ["touch", "touch"]
    assert contents(tmp_path) == contents(sampled)


@pytest.mark.parametrize("fixed", [True, False])
def test_depth_that_the_sensor_is_not_pressed_to_is_refused(brick, tmp_path, fixed):
    file, at = (with_images(brick, 0.0012, 0.3), "0.0012") if fixed else (brick, "0.0005 to 0.002")
    message = f"brick: observe.depth is 0.003 m, but its sensor digit is pressed {at} m deep; change observe"
    refused(message, sample_observations, file, replace(WANTED, depth=0.003), 7, tmp_path)
