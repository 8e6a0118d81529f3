"""`objectfolder bench` on two bricks, in a workspace of its own; what is wrong is said before any work."""

import csv
import json
import re
import shutil
from pathlib import Path

import pytest
import torch
import typer
from ruamel.yaml import YAML
from typer.testing import CliRunner

from objectfolder.base.arrays import open_safetensors, write_safetensors
from objectfolder.base.errors import ObjectFolderError
from objectfolder.benchmarks import run
from objectfolder.benchmarks.datasets.observations import certain_observations
from objectfolder.benchmarks.datasets.sampling import sample_observations
from objectfolder.benchmarks.datasets.settings import ObserveConfig
from objectfolder.benchmarks.datasets.splits import object_split
from objectfolder.benchmarks.tasks import recognize, retrieve
from objectfolder.benchmarks.tasks.task import find_task
from objectfolder.cli import app
from objectfolder.cli.console import track_progress
from objectfolder.objectfile.file import ObjectFile
from objectfolder.workspace.layout import Benchmarks
from objectfolder.workspace.params import read
from objectfolder.workspace.presets import read_preset
from objectfolder.workspace.stages import BENCHMARKS

ROOT = Path(__file__).parents[2]
TINY = {
    "observe": {"observations": 10, "resolution": 12},
    "encode": {"encoder": "mine.py:tiny", "image": 8, "spectrogram": [8, 8], "touch": [12, 12]},
    "recognize": {"seeds": 2, "epochs": 2, "fusion_epochs": 1, "batch": 8},
    "retrieve": {"seeds": 1, "epochs": 2, "batch": 8, "embedding": 4},
    "localize": {"seeds": 1, "contacts": 80, "epochs": 1, "batch": 16},
    "slide": {"seeds": 1, "contacts": 80, "episodes": 2, "epochs": 1, "batch": 16},
    "vision_to_touch": {"seeds": 1, "contacts": 10, "epochs": 1, "batch": 8, "width": 2},
    "touch_to_vision": {"seeds": 1, "epochs": 1, "batch": 8, "width": 2},
    "reconstruct": {
        **{"seeds": 1, "epochs": 1, "batch": 8, "points": 32, "width": 8, "blocks": 1},
        **{"resolution": 16, "score_points": 200, "views": 1, "touches": 2},
    },
}
ENCODER = """
from torch import nn
from objectfolder.benchmarks.models.encoders import register_encoder

@register_encoder("tiny")
class Tiny(nn.Sequential):
    features = 4

    def __init__(self, channels):
        super().__init__(nn.Conv2d(channels, 4, 5, 3), nn.ReLU(), nn.AdaptiveAvgPool2d(1), nn.Flatten())
"""


@pytest.fixture(scope="module")
def files(brick, tmp_path_factory):
    """Object Files of two bricks with different keys: one may be trained on, the other tested with."""
    folder = tmp_path_factory.mktemp("files")
    keys = {object_split(key): key for key in (f"brick_{i}" for i in range(99))}
    for key in (keys["train"], keys["test"]):
        (folder / key).mkdir()
        write_safetensors(
            folder / key / "ObjectFile.safetensors", dict(brick.tensors), {**brick.header, "key": key}
        )
    return folder


@pytest.fixture(scope="module")
def observed(files, tmp_path_factory):
    """Their observations; what the same call draws twice is another file's test."""
    folder = Benchmarks(tmp_path_factory.mktemp("observed"))
    for path in files.glob("*/ObjectFile.safetensors"):
        sample_observations(
            ObjectFile.load(path),
            ObserveConfig(observations=10, resolution=12),
            0,
            folder.observations(path.parent.name),
        )
    return folder.dir


@pytest.fixture
def workspace(tmp_path, monkeypatch, observed):
    values = read(ROOT / "params.yaml")
    for section, content in TINY.items():
        values[section] = {**values[section], **content}
    with (tmp_path / "params.yaml").open("w") as stream:
        YAML().dump(values, stream)
    shutil.copytree(ROOT / "params", tmp_path / "params")
    (tmp_path / "mine.py").write_text(ENCODER)
    for name in ("first", "second", "parts", "out"):  # "whole" is observed by the command
        shutil.copytree(observed, tmp_path / name)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def bench(*arguments):
    threads = () if "--threads" in arguments else ("--threads", "1")
    done = CliRunner().invoke(app, ["bench", *map(str, arguments), *threads])
    if done.exception and not isinstance(done.exception, SystemExit):
        raise done.exception
    assert done.exit_code == 0, done.output
    return done.output


def results(folder):
    """Files of results by name; a machine file holds how long it took."""
    return {
        path.name: path.read_bytes()
        for path in sorted(folder.iterdir())
        if path.is_file() and not path.stem.endswith("_machine")
    }


@pytest.mark.parametrize(
    ("command", "name"),
    [
        pytest.param("recognize", "recognize_seen", marks=pytest.mark.slow),
        pytest.param("retrieve", "retrieve_seen", marks=pytest.mark.slow),
        ("reconstruct", "reconstruct_seen"),
    ],
)
def test_a_task_prints_its_table_and_gives_the_same_bytes_again(files, workspace, command, name):
    split = () if command == "recognize" else ("--split", "seen")
    output = bench(command, files, "--out", "first", *split)
    assert "paper" in output
    assert f"first/{name}.json" in output
    scores = json.loads(Path(f"first/{name}.json").read_text())
    assert "seconds" not in scores
    with Path(f"first/{name}.csv").open() as stream:
        curve = list(csv.DictReader(stream))
    assert {"epoch", "train_loss"} < set(curve[0])
    assert json.loads(Path(f"first/{name}_machine.json").read_text())["threads"] == 1
    if command == "reconstruct":  # a model names no file whose code would run when it is read
        assert open_safetensors(f"first/{name}.safetensors")[1]["encoder"] == "tiny"
    bench(command, files, "--out", "second", *split)
    assert results(Path("first")) == results(Path("second"))


@pytest.mark.slow
def test_two_objects_at_a_time_are_localized_as_one_after_another(files, workspace):
    output = bench("localize", files, "--out", "first")
    assert "touch + sound" in output
    assert "mean of " in output
    assert "64 contacts to train with, 8 for validation, 8 for the test" in output
    written = [path.name for path in Path("first").glob("localize_*.json") if "_machine" not in path.name]
    assert len(written) == 2
    bench("localize", files, "--out", "second", "--jobs", "2", "--threads", "2")
    assert results(Path("first")) == results(Path("second"))


@pytest.mark.slow
def test_a_sensor_slides_to_contacts(files, workspace):
    output = bench("slide", files, "--out", "first")
    assert "pixel descent" in output
    assert "2 episodes of each way, of at most 15 steps; 80 contacts to learn from" in output
    assert len(list(Path("first").glob("slide_*.png"))) == 2
    bench("slide", files, "--out", "second", "--jobs", "2", "--threads", "2")
    assert results(Path("first")) == results(Path("second"))


@pytest.mark.slow
def test_touches_are_drawn_from_close_views(files, workspace):
    output = bench("vision-to-touch", files, "--out", "first", "--split", "seen")
    assert "touch of the most similar view" in output
    assert "2 objects; 16 contacts to train with" in output
    assert Path("first/vision_to_touch_seen.png").is_file()
    times = {path: path.stat().st_mtime_ns for path in Path("first/close_ups").rglob("*")}
    bench("vision-to-touch", files, "--out", "first", "--split", "seen", "--seeds", "2")
    output = bench("touch-to-vision", files, "--out", "first", "--split", "seen")
    assert "view of the most similar touch" in output
    assert times == {path: path.stat().st_mtime_ns for path in times}  # made once
    for task in ("vision_to_touch", "touch_to_vision"):
        assert Path(f"first/{task}_seen.png").is_file()


@pytest.mark.slow
def test_a_split_beside_another_gives_what_it_gives_alone(files, workspace):
    bench("reconstruct", files, "--out", "first", "--split", "unseen")
    alone = results(Path("first"))
    assert len(alone) == 4
    output = bench("reconstruct", files, "--out", "second", "--threads", "2")
    assert all(f"reconstruct_{split}.json" in output for split in ("seen", "unseen"))
    assert alone.items() < results(Path("second")).items()
    assert json.loads(Path("second/reconstruct_unseen_machine.json").read_text())["threads"] == 1


@pytest.fixture
def marked(files, brick, tmp_path):
    """Object Files of the bricks, and of one whose sound is marked uncertain."""
    header = {**brick.header, "key": "flimsy", "audio": {**brick.header["audio"], "uncertain": True}}
    folder = shutil.copytree(files, tmp_path / "marked")
    (folder / "flimsy").mkdir()
    write_safetensors(folder / "flimsy/ObjectFile.safetensors", dict(brick.tensors), header)
    return folder


def test_an_object_whose_sound_is_uncertain_is_left_out_where_sound_is_used(files, marked, workspace):
    line = "left out, since their sound is marked uncertain: flimsy"
    bench("recognize", files, "--out", "first", "--seeds", "1")
    output = bench("recognize", marked, "--out", "second", "--seeds", "1")
    assert output.count(line) == 2  # before the task, and below the table
    assert "2 objects, 10 observations of each" in output
    scores, plain = (json.loads(Path(f"{at}/recognize_seen.json").read_text()) for at in ("second", "first"))
    assert scores == plain | {"uncertain": ["flimsy"]}
    stage = certain_observations(
        {key: Path("second/observations") / key for key in (*plain["keys"], "flimsy")}
    )
    assert stage.uncertain == ("flimsy",)
    one = min(files.iterdir())
    with pytest.raises(ObjectFolderError, match="needs two at least"):
        bench("recognize", one, marked / "flimsy", "--out", "third")


def test_an_object_whose_sound_is_uncertain_is_localized_without_it(marked, workspace):
    output = bench("localize", marked / "flimsy", "--out", "first")
    assert "flimsy: its sound is marked uncertain, so contacts are localized without it" in output
    assert "Without sound, since theirs is marked uncertain: flimsy." in output
    assert "│ touch + sound" not in output
    scores = json.loads(Path("first/localize_flimsy.json").read_text())
    assert scores["uncertain"]
    assert "T" in scores
    assert not {"A", "TA", "TVA"} & scores.keys()
    assert 1 <= scores["diameter"] <= 3**0.5
    heard = {"T": scores["T"], "A": scores["T"], "TA": scores["T"], "constant": 1.0, "random": 1.0}
    heard["diameter"] = 1.0
    [table] = find_task("localize").tables(
        {"flimsy": scores, "other": heard | {"contacts": scores["contacts"]}}
    )
    assert [row[:2] for row in table.rows] == [
        ("touch", "flimsy"),
        ("touch", "other"),
        ("touch", "mean of 2"),
        ("sound", "other"),
        ("close view", "flimsy"),
        ("touch + sound", "other"),
        ("touch + close view", "flimsy"),
    ]


def test_another_seed_or_encoder_begins_anew(files, workspace):
    bench("recognize", files, "--out", "out")
    before = results(Path("out"))
    (workspace / "mine.py").write_text(ENCODER.replace("5, 3", "3, 2"))
    bench("recognize", files, "--out", "out")
    assert results(Path("out"))["recognize_seen.csv"] != before["recognize_seen.csv"]
    bench("recognize", files, "--out", "out", "--seeds", "1")
    assert len(json.loads(Path("out/recognize_seen.json").read_text())["V"]["seeds"]) == 1


def test_former_names_of_commands_still_work():
    known = typer.main.get_command(app).commands["bench"].commands
    former = {name: task.name for task in map(find_task, BENCHMARKS) for name in task.former}
    assert len(former) == 6
    for name, task in former.items():
        old, new = known[name], known[task.replace("_", "-")]
        assert old.hidden
        assert [param.name for param in old.params] == [param.name for param in new.params]


def refused(*arguments):
    with pytest.raises(ObjectFolderError) as refusal:
        bench(*arguments)
    assert not Path("benchmarks").exists()
    return str(refusal.value)


def test_what_is_wrong_is_said_before_any_work(files, workspace, tmp_path):
    one, other = sorted(files.iterdir())
    assert "needs two at least" in refused("recognize", one)
    assert "build does not exist; expected a file, release or folder of builds" in refused("recognize")
    assert "give each object once" in refused("recognize", one, other, other)
    assert "expected seen or unseen" in refused("retrieve", files, "--split", "sen")
    assert "expected one of quick, faithful, faithful-small, laptop, standard" in refused(
        "recognize", files, "--preset", "fast"
    )
    assert "nothing.pth does not exist" in refused("recognize", files, "--weights", "nothing.pth")
    torch.save({"layer9.weight": torch.zeros(3)}, "other.pth")
    assert "layer9.weight" in refused("recognize", files, "--preset", "quick", "--weights", "other.pth")
    assert "--split 'unseen' is unknown here, expected seen" in refused(
        "recognize", files, "--split", "unseen"
    )
    assert "nowhere.py does not exist" in refused("recognize", files, "--encoder", "nowhere.py:net")
    Path("wide.py").write_text(ENCODER.replace("features = 4", "features = 8"))
    for command in ("recognize", "retrieve", "reconstruct", "localize"):
        message = refused(command, files, "--encoder", "wide.py:tiny", "--out", "new")
        assert message.startswith("encoder wide.py:tiny, ")
        assert message.endswith("gives (2, 4), expected (2, 8): (B, features)")
    assert "--device gpu" in refused("recognize", files, "--device", "gpu", "--out", "new")
    assert "--device gpu" in refused("localize", files, "--device", "gpu", "--out", "new")
    assert not Path("new").exists()


def test_files_and_a_preset_need_no_workspace(files, workspace, tmp_path, monkeypatch):
    """Elsewhere all settings are the package's; in a workspace whose seed is the same, they are equal."""
    one, other = sorted(files.iterdir())
    options = run.BenchmarkOptions(files=[files], preset="quick")
    inside = options.params(recognize.TASK, *options.values())
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    values, path = options.values()
    assert values == read(ROOT / "params.yaml") | read_preset("quick", ROOT)[0]
    assert options.params(recognize.TASK, values, path) == inside
    assert options.folder.dir == Path("benchmarks/quick")
    assert "needs two at least" in refused("recognize", one, "--preset", "quick")
    assert "expected one of quick, faithful" in refused("recognize", one, other, "--preset", "fast")
    for words in ((one, other), ("--preset", "quick"), ()):
        message = refused("recognize", *words)
        assert message.startswith("params.yaml does not exist; run inside an objectfolder workspace, or name")
        assert "give --preset" in message
    assert list(Path().iterdir()) == []


def test_a_split_with_nothing_to_tell_apart_is_refused_before_objects_are_sampled(files, workspace):
    message = refused("retrieve", files, "--split", "unseen")
    assert re.search(r"split unseen trains on brick_\d+ alone", message)
    message = refused("recognize", files, "--label", "material", "--split", "seen")
    assert re.search(r"split seen: all objects for training are of \w+; add", message)


@pytest.mark.slow
def test_an_object_file_that_lacks_a_part_is_named(brick, files, workspace):
    silent = {name: array for name, array in brick.tensors.items() if not name.startswith("audio.")}
    header = {key: value for key, value in brick.header.items() if key != "audio"}
    write_safetensors("silent.safetensors", silent, {**header, "key": "silent"})
    with pytest.raises(ObjectFolderError, match=r"silent.*audio"):
        bench("recognize", files, "silent.safetensors", "--out", "out")
    assert not list(Path("out").glob("*.json"))


def test_unseen_needs_objects_to_test_with(brick, workspace, monkeypatch):
    keys = [key for key in (f"brick_{i}" for i in range(99)) if object_split(key) == "train"][:2]
    for key in keys:
        write_safetensors(f"{key}.safetensors", dict(brick.tensors), {**brick.header, "key": key})
    files = [f"{key}.safetensors" for key in keys]
    message = refused("retrieve", *files, "--split", "unseen")
    assert all(text in message for text in (*keys, "none is a test object", "split seen"))

    asked = []
    monkeypatch.setattr(run, "collect_samples", lambda *given: {})
    monkeypatch.setattr(run, "_call_all", lambda call, given, jobs: asked.extend(row[0] for row in given))
    monkeypatch.setattr(run, "read_json", lambda path: {})
    lines = []
    options = run.BenchmarkOptions(files=[*map(Path, files)])
    scores = run.run_task(retrieve.TASK, options, lines.append, track_progress)
    assert asked == [*scores] == ["seen"]
    assert lines[0].startswith("left out: split unseen: of brick_")
