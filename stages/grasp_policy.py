"""grasp_policy: Object File, hulls -> benchmarks/grasp_policy_<object>.json, .csv, .safetensors, .gif."""

from objectfolder.benchmarks.datasets.samples import object_digest
from objectfolder.benchmarks.tasks.grasp_policy import TASK
from objectfolder.benchmarks.tasks.grasp_policy_training import grasp_policy
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
    run_stage(TASK, grasp_policy, key, known)


if __name__ == "__main__":
    run(main, __doc__)
