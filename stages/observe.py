"""observe: ObjectFile.safetensors -> benchmarks/observations/<object>: random views, impacts and touches."""

from objectfolder.benchmarks.datasets.sampling import sample_observations
from objectfolder.benchmarks.datasets.settings import ObserveConfig
from objectfolder.objectfile.file import load_placed
from objectfolder.workspace.layout import Benchmarks, Build
from objectfolder.workspace.params import stage_params
from stages import run


def main(key: str) -> None:
    params = stage_params(ObserveConfig, key)
    file = load_placed(Build(key).object_file)
    folder = Benchmarks().observations(key)
    sample_observations(file, params.settings, params.seed, folder)


if __name__ == "__main__":
    run(main, __doc__)
