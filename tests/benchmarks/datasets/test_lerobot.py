"""Episodes for LeRobot: frames that hold what the object answers."""

import io
import json

import numpy as np
import pytest
from PIL import Image

from objectfolder.benchmarks.datasets.lerobot import ACTION, AUDIO, STATE, TOUCH, write_lerobot
from objectfolder.errors import ObjectFolderError

datasets = pytest.importorskip("datasets", reason="datasets is not installed")
EPISODES, FRAMES, FPS, RATE = 2, 5, 10, 8000


@pytest.fixture(scope="module")
def folder(brick, tmp_path_factory):
    out = tmp_path_factory.mktemp("lerobot") / "out"
    write_lerobot([brick], out, EPISODES, FRAMES / FPS, FPS, RATE)
    return out


@pytest.fixture(scope="module")
def frames(folder):
    import pyarrow.parquet as parquet

    return parquet.read_table(folder / "data/chunk-000/file-000.parquet").to_pylist()


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


def test_statistics_are_those_of_the_frames(folder, frames):
    found = json.loads((folder / "meta/stats.json").read_text())
    states = np.array([row[STATE] for row in frames])
    np.testing.assert_allclose(found[STATE]["mean"], states.mean(0), rtol=1e-5, atol=1e-9)
    assert found[STATE]["count"] == [len(frames)]
    assert np.shape(found[TOUCH]["std"]) == (3, 1, 1)
    assert 0 < found[TOUCH]["mean"][0][0][0] < 1


def test_windows_have_to_be_equal(brick, tmp_path):
    with pytest.raises(ObjectFolderError, match=r"fps is 30, .* 16000 Hz, for equal windows, such as 32"):
        write_lerobot([brick], tmp_path / "out", fps=30)
    with pytest.raises(ObjectFolderError, match="at least 2 frames"):
        write_lerobot([brick], tmp_path / "out", seconds=0.01)
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_lerobot_reads_the_dataset(folder):
    module = pytest.importorskip("lerobot.datasets.lerobot_dataset", reason="lerobot is not installed")
    found = module.LeRobotDataset("objectfolder/touch", root=folder)
    assert (found.num_episodes, found.num_frames, found.fps) == (EPISODES, EPISODES * FRAMES, FPS)
    frame = found[FRAMES]
    assert frame["episode_index"] == 1
    assert frame["task"] == "press and hear brick"
    assert frame[TOUCH].shape == (3, 160, 120)
    assert frame[AUDIO].shape == (RATE // FPS,)
