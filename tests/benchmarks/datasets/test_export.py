import errno
import io
import json
import shutil

import numpy as np
import pytest
import soundfile
from folders import contents
from PIL import Image
from refusals import refused
from typer.testing import CliRunner

from objectfolder.base.arrays import wav_bytes
from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.installation import install_command
from objectfolder.benchmarks.datasets import export
from objectfolder.benchmarks.datasets.export import write_datasets, write_webdataset
from objectfolder.benchmarks.datasets.observations import Observations, find_folders
from objectfolder.benchmarks.datasets.sampling import sample_observations
from objectfolder.benchmarks.datasets.settings import ObserveConfig
from objectfolder.benchmarks.datasets.splits import named_split
from objectfolder.cli import app
from objectfolder.objectfile.file import ObjectFile

KEYS = ("espresso_mug", "tea_beaker", "own")  # for training, for tests, for training
COUNT = 10


@pytest.fixture(scope="module")
def root(brick, tmp_path_factory):
    """A brick's observations under several names, with its views darker each time."""
    root = tmp_path_factory.mktemp("objects")
    file = ObjectFile(brick.header | {"key": KEYS[0]}, dict(brick.tensors))
    sample_observations(file, ObserveConfig(observations=COUNT, resolution=8), 0, root / KEYS[0])
    for i, key in enumerate(KEYS[1:], 1):
        (root / key).mkdir()
        for path in (root / KEYS[0]).iterdir():
            (root / key / path.name).write_bytes(path.read_bytes())
        np.save(root / key / "vision.npy", np.load(root / key / "vision.npy", allow_pickle=False) // (i + 1))
        record = json.loads((root / key / "observations.json").read_text())
        (root / key / "observations.json").write_text(json.dumps(record | {"key": key}))
    return root


@pytest.fixture(scope="module")
def observations(root):
    return Observations(find_folders([root]))


def split_of(observations, name="seen"):
    return named_split(name, observations.keys, observations.count)


def check(observations, row, vision, audio, touch):
    """Decoded files against a row."""
    index = np.array([row])
    assert (vision == observations.read("vision", index)[0]).all()
    assert (touch == observations.read("touch", index)[0]).all()
    sound, rate = soundfile.read(io.BytesIO(audio), dtype="float32")
    assert rate == 16000
    assert (sound == observations.read("audio", index)[0]).all()


@pytest.mark.filterwarnings("ignore:unclosed file .*.tar:ResourceWarning")  # of the library's reader
@pytest.mark.parametrize("name", ["seen", "unseen"])
def test_webdataset_gives_back_every_observation(observations, tmp_path, name):
    import webdataset

    split = split_of(observations, name)
    write_webdataset(observations, split, tmp_path / "out", shard=7)
    index = json.loads((tmp_path / "out" / "index.json").read_text())
    assert index["split"] == name
    assert index["labels"] == list(observations.keys)
    for part in ("train", "val", "test"):
        rows = []
        for shard in index["shards"][part]:
            path = str(tmp_path / "out" / shard["file"])
            samples = list(webdataset.WebDataset(path, shardshuffle=False).decode("rgb8"))
            assert len(samples) == shard["samples"] <= 7
            for sample in samples:
                said = sample["json"]
                row = said["label"] * COUNT + said["observation"]
                assert sample["__key__"] == f"{said['key']}_{said['observation']:06d}"
                assert said["key"] == observations.keys[said["label"]]
                assert (said["material"], said["scale"], said["sensor"]) == ("plastic", 0.1, "digit")
                queries = observations.queries(said["key"])
                assert said["queries"].keys() == queries.keys()
                for query, values in queries.items():
                    assert (np.array(said["queries"][query]) == values[said["observation"]]).all()
                check(observations, row, sample["vision.png"], sample["audio.wav"], sample["touch.png"])
                rows.append(row)
        assert sorted(rows) == getattr(split, part).tolist()
        if len(rows) > 10:
            assert rows != sorted(rows)  # shuffled: a reader sees a shard after the other


@pytest.mark.parametrize("name", ["seen", "unseen"])
def test_datasets_gives_back_every_observation(observations, tmp_path, name, monkeypatch):
    datasets = pytest.importorskip("datasets")
    monkeypatch.setattr(datasets.config, "HF_HUB_OFFLINE", True)
    split = split_of(observations, name)
    write_datasets(observations, split, tmp_path / "out")
    loaded = datasets.load_dataset(str(tmp_path / "out"), cache_dir=str(tmp_path / "cache"))
    features = loaded["train"].features
    assert features["label"].names == list(observations.keys)
    assert isinstance(features["vision"], datasets.Image)
    assert isinstance(features["touch"], datasets.Image)
    assert isinstance(features["audio"], datasets.Audio)
    assert list(loaded) == ["train", "validation", "test"]
    for part, rows in zip(loaded, (split.train, split.val, split.test)):
        for row, sample in zip(rows.tolist(), loaded[part], strict=True):
            assert (sample["label"], sample["observation"]) == divmod(row, COUNT)
            queries = observations.queries(observations.keys[sample["label"]])
            for query, values in queries.items():
                assert (np.array(sample[query]) == values[sample["observation"]]).all()
            assert sample["audio"]["path"].endswith("_audio.wav")
            vision, touch = np.array(sample["vision"]), np.array(sample["touch"])
            check(observations, row, vision, sample["audio"]["bytes"], touch)


@pytest.fixture(params=[write_webdataset, write_datasets])
def write(request):
    return request.param


def test_the_same_observations_give_the_same_bytes_in_a_new_folder(
    observations, tmp_path, write, monkeypatch
):
    write(observations, split_of(observations), tmp_path / "first")
    monkeypatch.setattr("time.time", lambda: 2e9)
    write(observations, split_of(observations), tmp_path / "second")
    assert contents(tmp_path / "first") == contents(tmp_path / "second")
    refused(f"{tmp_path} exists already", write, observations, split_of(observations), tmp_path)


@pytest.mark.parametrize("key", ["../own", "<b>", "a\x1b[2J"])
def test_a_record_with_another_key_than_a_name_is_refused(root, tmp_path, write, key):
    """Keys name files of archives, and stand in the card."""
    shutil.copytree(root, tmp_path / "observations")
    record = tmp_path / "observations" / KEYS[0] / "observations.json"
    record.write_text(json.dumps(json.loads(record.read_text()) | {"key": key}))
    observations = Observations(find_folders([tmp_path]))
    with pytest.raises(ObjectFolderError, match=r"key of observations is .*, expected a letter, then"):
        write(observations, split_of(observations), tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("error", [KeyboardInterrupt(), OSError(errno.ENOSPC, "No space left on device")])
def test_what_is_broken_off_leaves_nothing(observations, tmp_path, write, error, monkeypatch):
    def fail(sound, rate):
        raise error

    monkeypatch.setattr(export, "wav_bytes", fail)
    wanted = KeyboardInterrupt if isinstance(error, KeyboardInterrupt) else ObjectFolderError
    with pytest.raises(wanted, match="no space in" if wanted is ObjectFolderError else None):
        write(observations, split_of(observations), tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_progress_is_reported(observations, tmp_path, write):
    heard, more = [], {"shard": 4} if write is write_webdataset else {}
    write(
        *(observations, split_of(observations), tmp_path / "a"),
        **{"report": lambda done, total: heard.append((done, total)), **more},
    )
    assert heard == [(done, 30) for done in (range(1, 31) if more else (24, 27, 30))]


def test_png_and_wav_are_what_other_readers_expect():
    image = np.arange(2 * 3 * 3, dtype=np.uint8).reshape(2, 3, 3)
    read = Image.open(io.BytesIO(export.png_bytes(image)))
    assert (read.mode, read.size) == ("RGB", (3, 2))
    info = soundfile.info(io.BytesIO(wav_bytes(np.array([0, 1e-9, -3], np.float32), 16000)))
    assert (info.format, info.subtype, info.samplerate, info.frames) == ("WAV", "FLOAT", 16000, 3)


def run(*words):
    return CliRunner().invoke(app, ["export", *map(str, words)])


@pytest.mark.parametrize(
    ("library", "given", "said"),
    [
        ("webdataset", [""], "24 samples to train, 3 to validate, 3 to test"),
        ("datasets", [""], "24 samples to train, 3 to validate, 3 to test"),
        ("webdataset", KEYS[:2], "9 samples to train, 1 to validate, 10 to test"),
    ],
)
def test_commands_take_folders_of_one_or_more_objects(root, tmp_path, library, given, said):
    split = ["--split", "unseen"] if len(given) > 1 else []
    result = run(library, *(root / name for name in given), tmp_path / "out", *split)
    assert result.exit_code == 0, result.output
    assert f"{2 if split else 3} objects" in result.output
    assert said in result.output
    assert contents(tmp_path / "out")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [(["--split", "other"], "split 'other' is unknown"), (["{tmp}"], "contains no observations")],
)
def test_commands_say_what_is_wrong(root, tmp_path, arguments, message):
    result = run("datasets", root, *(word.format(tmp=tmp_path) for word in arguments), tmp_path / "out")
    assert isinstance(result.exception, ObjectFolderError)
    assert message in str(result.exception)


def test_library_that_is_not_there_is_named(root, tmp_path, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    result = run("webdataset", root, tmp_path / "out")
    assert f"webdataset is not installed; this needs: {install_command('hub')}" in str(result.exception)


def test_folders_are_found_at_any_depth_and_once(root, tmp_path):
    assert find_folders([root, root / KEYS[0]]) == {key: root / key for key in KEYS}
    copy = tmp_path / "copy"
    copy.mkdir()
    (copy / "observations.json").write_bytes((root / KEYS[0] / "observations.json").read_bytes())
    refused(f"{KEYS[0]}: both .* hold its observations; pass only one", find_folders, [root, copy])
