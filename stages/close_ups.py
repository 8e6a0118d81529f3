"""close_ups: ObjectFile.safetensors -> benchmarks/close_ups/<object>: close views, and touches there."""

from objectfolder.benchmarks.datasets.close_ups import sample_close_ups
from objectfolder.benchmarks.models.settings import EncodeConfig
from objectfolder.benchmarks.tasks.vision_to_touch import VisionToTouchConfig
from objectfolder.objectfile.file import ObjectFile
from objectfolder.workspace.layout import Benchmarks, Build
from objectfolder.workspace.params import stage_params
from stages import run


def main(key: str) -> None:
    params = stage_params(VisionToTouchConfig, key)
    size = stage_params(EncodeConfig, key).settings.touch
    file = ObjectFile.load(Build(key).object_file)
    sample_close_ups(file, params.settings.contacts, size, params.seed, Benchmarks().close_ups(key))


if __name__ == "__main__":
    run(main, __doc__)
