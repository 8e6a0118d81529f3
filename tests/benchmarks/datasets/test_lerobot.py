"""Episodes for LeRobot: frames that hold what the object answers."""

import io
import json

import numpy as np
import pytest
from brick import with_images
from PIL import Image
from refusals import refused

from objectfolder.base.errors import ObjectFolderError
from objectfolder.benchmarks.datasets import lerobot as module
from objectfolder.benchmarks.datasets.lerobot import ACTION, AUDIO, STATE, STATES, TOUCH, write_lerobot
from objectfolder.objectfile.file import ObjectFile

datasets = pytest.importorskip("datasets", reason="datasets is not installed")
EPISODES, FRAMES, FPS, RATE = 2, 5, 10, 8000


@pytest.fixture(scope="module")
def folder(brick, tmp_path_factory):
    out = tmp_path_factory.mktemp("lerobot") / "out"
    write_lerobot([brick], out, EPISODES, FRAMES / FPS, FPS, RATE)
    return out


@pytest.fixture(scope="module")
def frames(folder):
    return parquet_rows(folder / "data/chunk-000/file-000.parquet")


def parquet_rows(path):
    import pyarrow.parquet as parquet

    return parquet.read_table(path).to_pylist()


def test_frames_are_numbered_as_the_format_asks(folder, frames):
    info = json.loads((folder / "meta/info.json").read_text())
    assert info["codebase_version"] == "v3.0"
    assert (info["total_episodes"], info["total_frames"], info["fps"]) == (EPISODES, EPISODES * FRAMES, FPS)
    assert [row["index"] for row in frames] == list(range(EPISODES * FRAMES))
    assert [row["episode_index"] for row in frames] == [0] * FRAMES + [1] * FRAMES
    np.testing.assert_allclose([row["timestamp"] for row in frames[:FRAMES]], np.arange(FRAMES) / FPS)
    assert set(frames[0]) == set(info["features"])
    for name, feature in info["features"].items():
        if feature["dtype"] != "image":
            assert np.atleast_1d(frames[0][name]).shape == tuple(feature["shape"]), name
            dtype = str(np.atleast_1d(frames[0][name]).dtype)
            assert dtype[0] == feature["dtype"][0], name


def test_windows_of_sound_make_the_whole_sound_of_the_strike(brick, frames):
    for episode in range(EPISODES):
        rows = [row for row in frames if row["episode_index"] == episode]
        point, normal = np.array(rows[0][STATE][:3]), np.array(rows[0][STATE][3:6])
        heard = np.concatenate([row[AUDIO] for row in rows])
        assert len(heard) == RATE * FRAMES // FPS
        truth = brick.impact([point], [-0.01 * normal], RATE, FRAMES / FPS)[0]
        np.testing.assert_allclose(heard, truth, atol=1e-4 * np.abs(truth).max())


def test_images_are_those_of_the_presses(brick, frames):
    row = frames[2]
    felt = brick.press([row[STATE][:3]], row[STATE][6])
    with Image.open(io.BytesIO(row[TOUCH]["bytes"])) as image:
        difference = np.asarray(image).astype(int) - felt.images[0]
    assert np.abs(difference).mean() < 0.5
    assert row[STATE][7] == pytest.approx(felt.force[0], rel=0.01)
    depths = [row[STATE][6] for row in frames[:FRAMES]]
    np.testing.assert_allclose([row[ACTION] for row in frames[: FRAMES - 1]], depths[1:], rtol=1e-6)
    low, high = brick.sensor_profile.press_depth
    assert low <= max(depths) <= high
    assert depths[0] == 0


def test_the_normal_is_that_of_the_press_and_the_strike_that_of_the_surface(brick, monkeypatch):
    """They differ at an edge."""
    strike = np.array([[0.0495, 0.03, 0, 0, -module.IMPULSE, 0]])
    monkeypatch.setattr(module, "sample_strikes", lambda *arguments: strike)
    (episode,) = module._episodes(brick, 1, FRAMES, FPS, RATE, np.random.default_rng(0))
    normals = np.array([frame[STATE][3:6] for frame in episode])
    np.testing.assert_allclose(normals, np.tile(brick.contact_normals(strike[:, :3]), (FRAMES, 1)), atol=1e-6)
    assert normals[0, 0] > 0.1
    heard = np.concatenate([frame[AUDIO] for frame in episode])
    truth = brick.impact(strike[:, :3], strike[:, 3:], RATE, FRAMES / FPS)[0]
    np.testing.assert_allclose(heard, truth, atol=1e-6 * np.abs(truth).max())


def test_the_library_of_the_hub_reads_frames_episodes_and_tasks(folder, tmp_path):
    found = datasets.load_dataset(
        "parquet", data_files=str(folder / "data/*/*.parquet"), split="train", cache_dir=str(tmp_path)
    )
    assert len(found) == EPISODES * FRAMES
    assert isinstance(found[0][TOUCH], Image.Image)
    pandas = pytest.importorskip("pandas")
    episodes = pandas.read_parquet(folder / "meta/episodes/chunk-000/file-000.parquet")
    assert episodes["dataset_to_index"].tolist() == [FRAMES, 2 * FRAMES]
    assert [list(tasks) for tasks in episodes["tasks"]] == [["press and hear brick"]] * 2
    tasks = pandas.read_parquet(folder / "meta/tasks.parquet")
    assert tasks.loc["press and hear brick", "task_index"] == 0


def test_statistics_are_those_of_all_frames_and_of_each_episode(folder, frames):
    whole = json.loads((folder / "meta/stats.json").read_text())
    cases = [(whole, frames)]
    for row in parquet_rows(folder / "meta/episodes/chunk-000/file-000.parquet"):
        own = {name: {key: row[f"stats/{name}/{key}"] for key in whole[name]} for name in whole}
        cases.append((own, [frame for frame in frames if frame["episode_index"] == row["episode_index"]]))
    assert [len(rows) for _, rows in cases] == [EPISODES * FRAMES, *[FRAMES] * EPISODES]
    for found, rows in cases:
        assert set(found) == set(frames[0])
        for name in (STATE, AUDIO, ACTION, TOUCH):
            values = np.array([np.atleast_1d(row[name]) for row in rows]) if name != TOUCH else pixels(rows)
            truth = {"mean": values.mean(0), "std": values.std(0), "min": values.min(0), "max": values.max(0)}
            for key, share in {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}.items():
                truth[key] = np.sort(values, 0)[int(np.ceil(share * len(values))) - 1]
            assert found[name].pop("count") == [len(rows)]
            assert set(found[name]) == set(truth)
            for key, value in truth.items():
                expected = value[:, None, None] if name == TOUCH else value
                np.testing.assert_allclose(found[name][key], expected, 1e-5, 1e-6 * np.abs(values).max())


def pixels(rows):
    """All pixels of the tactile images, (P, 3), in [0, 1]."""
    return np.concatenate([image_of(row).reshape(-1, 3) / 255 for row in rows])


def image_of(row):
    with Image.open(io.BytesIO(row[TOUCH]["bytes"])) as image:
        return np.asarray(image)


def test_windows_have_to_be_equal(brick, tmp_path):
    with pytest.raises(ObjectFolderError, match=r"fps is 30, .* 16000 Hz, for equal windows, such as 32"):
        write_lerobot([brick], tmp_path / "out", fps=30)
    refused("at least 2 frames", write_lerobot, [brick], tmp_path / "out", seconds=0.01)
    assert not (tmp_path / "out").exists()


def test_each_object_has_a_task_of_its_own(brick, tmp_path):
    with pytest.raises(ObjectFolderError, match=r"different keys, .* got \['brick', 'brick'\]"):
        write_lerobot([brick, brick], tmp_path / "out")


def test_nets_that_need_a_press_are_refused_before_anything_is_written(brick, tmp_path):
    image = with_images(brick, 0.001, 0.0)
    other = ObjectFile(image.header | {"key": "other"}, image.tensors, "other")
    with pytest.raises(ObjectFolderError, match="other: its touch net is of kind 'image', expected 'geom"):
        write_lerobot([brick, other], tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.fixture(scope="module")
def lerobot(tmp_path_factory):
    """The library, which keeps tables in a cache."""
    library = pytest.importorskip("lerobot.datasets.lerobot_dataset", reason="lerobot is not installed")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(datasets.config, "HF_DATASETS_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield library


@pytest.fixture(scope="module")
def two_objects(brick, tmp_path_factory):
    """Folder with the episodes of two objects that differ in their keys."""
    out = tmp_path_factory.mktemp("lerobot") / "out"
    slab = ObjectFile(brick.header | {"key": "slab"}, brick.tensors, "slab")
    write_lerobot([brick, slab], out, EPISODES, FRAMES / FPS, FPS, RATE)
    return out


@pytest.mark.slow
def test_lerobot_reads_the_frames_that_were_written(lerobot, two_objects):
    found = lerobot.LeRobotDataset("objectfolder/touch", root=two_objects)
    assert (found.num_episodes, found.num_frames, found.fps) == (2 * EPISODES, 2 * EPISODES * FRAMES, FPS)
    assert found.meta.camera_keys == [TOUCH]
    assert found.meta.names[STATE] == list(STATES)
    shapes = {TOUCH: (160, 120, 3), AUDIO: (RATE // FPS,), STATE: (8,), ACTION: (1,)}
    assert {name: found.meta.shapes[name] for name in shapes} == shapes
    written = parquet_rows(two_objects / "data/chunk-000/file-000.parquet")
    assert len(found) == len(written)
    for k, row in enumerate(written):
        frame = found[k]
        assert frame["task"] == ("press and hear brick" if k < EPISODES * FRAMES else "press and hear slab")
        assert frame[TOUCH].shape == (3, 160, 120)
        np.testing.assert_array_equal((255 * frame[TOUCH].numpy()).round().transpose(1, 2, 0), image_of(row))
        for name in set(row) - {TOUCH}:
            np.testing.assert_array_equal(frame[name].numpy(), np.float32(row[name]))
    for number, episode in enumerate(found.meta.episodes):
        assert episode["dataset_from_index"] == number * FRAMES
        assert episode["dataset_to_index"] == (number + 1) * FRAMES
        assert episode["tasks"] == [found[number * FRAMES]["task"]]


@pytest.mark.slow
def test_lerobots_windows_end_where_episodes_end(lerobot, folder, frames):
    """Asked for the frames before and after, it marks what would be of another episode."""
    found = lerobot.LeRobotDataset(
        "objectfolder/touch", root=folder, delta_timestamps={AUDIO: [-1 / FPS, 0, 1 / FPS]}
    )
    for k in range(len(found)):
        start, end = k // FRAMES * FRAMES, k // FRAMES * FRAMES + FRAMES - 1
        wanted = np.arange(k - 1, k + 2)
        frame = found[k]
        expected = [frames[index][AUDIO] for index in wanted.clip(start, end)]
        np.testing.assert_array_equal(frame[AUDIO].numpy(), np.float32(expected))
        outside = (wanted < start) | (wanted > end)
        np.testing.assert_array_equal(frame[f"{AUDIO}_is_pad"].numpy(), outside)
    only = lerobot.LeRobotDataset("objectfolder/touch", root=folder, episodes=[1])
    assert [int(frame["index"]) for frame in only] == list(range(FRAMES, 2 * FRAMES))


@pytest.mark.slow
def test_statistics_are_those_that_lerobot_computes(lerobot, folder, frames):
    """Of images as real numbers: the squares of its whole numbers overflow in version 0.4.4."""
    from lerobot.datasets.compute_stats import get_feature_stats

    meta = lerobot.LeRobotDataset("objectfolder/touch", root=folder).meta
    for name in (STATE, AUDIO, ACTION, TOUCH):
        if name == TOUCH:
            images = np.array([image_of(row).transpose(2, 0, 1) / 255 for row in frames])
            truth = get_feature_stats(images, (0, 2, 3), keepdims=True)
            truth = {key: value[0] if key != "count" else value for key, value in truth.items()}
        else:
            values = np.array([row[name] for row in frames])
            truth = get_feature_stats(values, 0, keepdims=values.ndim == 1)
        largest = np.abs(truth["max"]).max()
        assert set(meta.stats[name]) == set(truth)
        for key, value in truth.items():
            given = meta.stats[name][key]
            assert given.shape == value.shape, (name, key)
            if not key.startswith("q"):
                np.testing.assert_allclose(given, value, 1e-5, 1e-6 * largest, err_msg=f"{name} {key}")
            elif name == TOUCH:  # it reads quantiles off histograms
                np.testing.assert_allclose(given, value, atol=1 / 255)
            else:  # and between the few values that there are
                assert (given >= truth["min"] - 1e-6 * largest).all()
                assert (given <= truth["max"] + 1e-6 * largest).all()


@pytest.mark.slow
def test_lerobots_tools_split_and_merge_the_dataset(lerobot, two_objects, tmp_path):
    """They need the statistics of each episode."""
    from lerobot.datasets import dataset_tools

    whole = lerobot.LeRobotDataset("objectfolder/touch", root=two_objects)
    parts = {"brick": [*range(EPISODES)], "slab": [*range(EPISODES, 2 * EPISODES)]}
    split = dataset_tools.split_dataset(whole, parts, tmp_path / "split")
    assert {name: part.num_frames for name, part in split.items()} == dict.fromkeys(parts, EPISODES * FRAMES)
    slab = whole.meta.episodes[EPISODES]["dataset_from_index"]
    rows = [whole[k][STATE].numpy() for k in range(slab, len(whole))]
    mean = split["slab"].meta.stats[STATE]["mean"]
    np.testing.assert_allclose(mean, np.mean(rows, 0), rtol=1e-5, atol=1e-9)
    assert split["slab"][0]["task"] == "press and hear slab"
    merged = dataset_tools.merge_datasets([*split.values()], "objectfolder/merged", tmp_path / "merged")
    assert (merged.num_episodes, merged.num_frames) == (whole.num_episodes, whole.num_frames)
    for name in (STATE, TOUCH, AUDIO):
        np.testing.assert_array_equal(merged[slab][name].numpy(), whole[slab][name].numpy())
        for key in ("min", "max", "mean", "std", "count"):
            found, expected = (of.meta.stats[name][key] for of in (merged, whole))
            np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-12)
