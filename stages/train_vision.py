"""train_vision: views, visual.glb, sdf.npz -> vision.safetensors, vision_curve.csv."""

from objectfolder.base.arrays import read_npz
from objectfolder.mesh.grid import DistanceGrid
from objectfolder.mesh.isosurface import Isosurface
from objectfolder.mesh.reading.load import AS_STORED, load_mesh
from objectfolder.vision.net_settings import VisionConfig
from objectfolder.vision.scene import Scene
from objectfolder.workspace.layout import Build
from objectfolder.workspace.params import stage_params
from objectfolder.workspace.training import train_net
from stages import log_point, run

TRAININGS = "objectfolder.vision.*_training"


def main(key: str) -> None:
    params, build = stage_params(VisionConfig, key), Build(key)
    inputs = build.views("train"), build.views("val")
    train, val = (read_npz(path, "rgba", "camera_to_world", "light", "focal", "center") for path in inputs)
    data = (
        *(train, val),
        lambda: Isosurface(DistanceGrid.from_arrays(read_npz(build.sdf, "values", "band"))),
        lambda: Scene(load_mesh(build.visual, "y", AS_STORED)),
    )
    train_net(TRAININGS, "vision", key, params.seed, params.settings, data, inputs, log_point)


if __name__ == "__main__":
    run(main, __doc__)
