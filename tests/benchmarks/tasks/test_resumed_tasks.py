"""A task that is interrupted, wherever, goes on to the same scores, curves and files, and repeats nothing."""

from dataclasses import replace

import pytest
import test_grasp_stability as stability
import test_localize as localizing
import test_recognize as recognizing
import test_reconstruct as reconstructing
import test_retrieve as retrieving
import test_slide as sliding
import test_vision_to_touch as translating

from objectfolder.benchmarks.tasks import job as jobs
from objectfolder.benchmarks.tasks import recognize_training
from objectfolder.benchmarks.tasks.grasp_stability_training import grasp_stability
from objectfolder.benchmarks.tasks.localize_training import localize
from objectfolder.benchmarks.tasks.recognize_training import recognize
from objectfolder.benchmarks.tasks.reconstruct_training import reconstruct
from objectfolder.benchmarks.tasks.retrieve_training import retrieve
from objectfolder.benchmarks.tasks.slide_training import slide_object
from objectfolder.benchmarks.tasks.touch_to_vision_training import touch_to_vision
from objectfolder.benchmarks.tasks.vision_to_touch_training import vision_to_touch
from objectfolder.objectfile.file import ObjectFile

occupancy = reconstructing.occupancy
#: Sizes 16 and 40; the first net of a seed is trained alone, the last from several.
FEW_GRASPS = {"sizes": (16, 40), "epochs": 2, "epoch_grasps": 16}
SLOW = pytest.mark.slow


def shapes(folder, pretrain_epochs):
    made = reconstructing.make_job(folder)
    return replace(made, params=replace(made.params, pretrain_epochs=pretrain_epochs, epochs=2, views=1))


@pytest.mark.parametrize(
    ("task", "make"),
    [
        (recognize, lambda folder: recognizing.make_job(recognizing.Table(20), folder, epochs=2)),
        (grasp_stability, lambda folder: stability._job(stability.FakeGrasps(20), folder, **FEW_GRASPS)),
        (localize, lambda folder: localizing.job(folder, epochs=3)),
        (vision_to_touch, lambda folder: translating.job(folder, epochs=3)),
        (touch_to_vision, lambda folder: translating.back(folder, translating.pairs(), epochs=3)),
        (retrieve, lambda folder: retrieving.make_job(retrieving.Table(3), folder, epochs=3)),
        (
            retrieve,
            lambda folder: retrieving.make_job(retrieving.Table(3), folder, epochs=1, pretrain_epochs=2),
        ),
        (reconstruct, lambda folder: shapes(folder, 0)),
        pytest.param(reconstruct, lambda folder: shapes(folder, 2), marks=SLOW),
        pytest.param(
            slide_object, lambda folder: sliding.job(ObjectFile.sample("bell"), folder, epochs=2), marks=SLOW
        ),
    ],
    ids=lambda value: value.__name__ if value.__name__ != "<lambda>" else "",
)
def test_an_interrupted_task_goes_on(tmp_path, monkeypatch, occupancy, task, make):
    monkeypatch.setattr(recognize_training, "draw_confusion", lambda title, counts, names, path: path.touch())

    def run(folder, report):
        scores, curve = task(replace(make(tmp_path / folder), report=report))
        assert scores.pop("seconds") > 0
        files = {path.name: path.read_bytes() for path in (tmp_path / folder).iterdir()}
        assert not any(name.endswith(".pt") for name in files)
        return scores, curve, {name: files.get(name) for name in ("model.safetensors", "sheet.png")}

    said, lines = [], []
    whole = run("whole", said.append)
    assert len(said) >= len(whole[1])
    for at in sorted({1, 2, len(said) // 2, len(said)}):

        def stop(line, at=at):
            lines.append(line)
            if len(lines) == at:
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            run("parts", stop)
    assert run("parts", lines.append) == whole
    names = [line.partition(":")[0] for line in lines]
    assert names == [line.partition(":")[0] for line in said]
    assert len(names) == len(set(names))  # no epoch twice
    monkeypatch.setattr(jobs, "train", lambda *given: pytest.fail("what is finished is trained again"))
    assert run("parts", lines.append) == whole
