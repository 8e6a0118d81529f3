"""localize: Object File -> benchmarks/localize_<object>.json, .csv: where was it touched or struck?"""

from objectfolder.benchmarks.datasets.samples import object_digest
from objectfolder.benchmarks.tasks.localize import TASK
from objectfolder.benchmarks.tasks.localize_training import localize_object
from objectfolder.benchmarks.tasks.running import KnownObject, run_stage
from objectfolder.objectfile.file import ObjectFile
from objectfolder.workspace.layout import Build
from stages import run


def main(key: str) -> None:
    file = ObjectFile.load(Build(key).object_file)
    run_stage(TASK, localize_object, key, KnownObject(file, object_digest(file)))


if __name__ == "__main__":
    run(main, __doc__)
