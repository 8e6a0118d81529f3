"""slide: Object File -> benchmarks/slide_<object>.json, .csv, .png: slide a sensor to a contact."""

from objectfolder.benchmarks.datasets.samples import object_digest
from objectfolder.benchmarks.tasks.running import KnownObject, run_stage
from objectfolder.benchmarks.tasks.slide import TASK
from objectfolder.benchmarks.tasks.slide_training import slide_object
from objectfolder.objectfile.file import ObjectFile
from objectfolder.workspace.layout import Build
from stages import run


def main(key: str) -> None:
    file = ObjectFile.load(Build(key).object_file)
    run_stage(TASK, slide_object, key, KnownObject(file, object_digest(file)))


if __name__ == "__main__":
    run(main, __doc__)
