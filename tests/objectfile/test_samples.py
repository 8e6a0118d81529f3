from pathlib import Path

from refusals import refused

from objectfolder import ObjectFile
from objectfolder.base.arrays import safetensors_bytes
from objectfolder.objectfile.samples import available_samples, file_or_sample, sample_path
from objectfolder.stored.header import format_name


def test_samples_are_small_files_of_this_format():
    assert available_samples() == ["bell", "die", "mug"]
    assert sum(sample_path(name).stat().st_size for name in available_samples()) < 1_650_000
    for name in available_samples():
        sample = ObjectFile.sample(name)
        assert sample.header["format"] == format_name(), "run `make samples`"
        sample.check()
        assert sample.key == name
    refused("bell, die, mug", ObjectFile.sample, "../mug")


def test_a_file_of_the_same_name_comes_before_a_sample(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("mug").mkdir()
    assert file_or_sample(Path("mug")) == sample_path("mug")
    Path("die").write_bytes(b"a file of that name")
    assert file_or_sample(Path("die")) == Path("die")
    assert file_or_sample(Path("cup")) == Path("cup")


def test_bytes_are_those_of_the_file(brick, brick_path):
    assert safetensors_bytes(brick.tensors, brick.header) == brick_path.read_bytes()


def test_a_notebook_shows_the_page(brick):
    frame = brick._repr_html_()
    assert frame.startswith("<iframe srcdoc=")
    assert frame.count("<") == 2, "what the frame holds is escaped"
