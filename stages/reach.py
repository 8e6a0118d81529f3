"""reach: Object File and its hulls -> benchmarks/reach_<key>.json, .csv, .safetensors, .gif: PPO on reach."""

from objectfolder.benchmarks.datasets.samples import object_digest
from objectfolder.benchmarks.tasks.reach import TASK
from objectfolder.benchmarks.tasks.reach_training import reach
from objectfolder.benchmarks.tasks.running import KnownObject, run_stage
from objectfolder.objectfile.file import ObjectFile
from objectfolder.sim.body import rigid_body
from objectfolder.sim.hulls import hulls_digest, read_hulls
from objectfolder.workspace.layout import Build
from stages import run


def main(key: str) -> None:
    build = Build(key)
    file, hulls = ObjectFile.load(build.object_file), read_hulls(build.hulls)
    known = KnownObject(file, object_digest(file) + hulls_digest(hulls), rigid_body(file, hulls))
    run_stage(TASK, reach, key, known)


if __name__ == "__main__":
    run(main, __doc__)
