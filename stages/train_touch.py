"""train_touch: touches, sdf.npz, sensor profile -> touch.safetensors, touch_curve.csv."""

from objectfolder.base.arrays import read_npz
from objectfolder.mesh.grid import DistanceGrid
from objectfolder.mesh.isosurface import Isosurface
from objectfolder.touch.net_settings import TouchConfig
from objectfolder.touch.profiles import load_profile
from objectfolder.workspace.installed import sensor_file
from objectfolder.workspace.layout import Build
from objectfolder.workspace.params import stage_params
from objectfolder.workspace.training import train_net
from stages import log_point, run

TRAININGS = "objectfolder.touch.*_training"


def main(key: str) -> None:
    params, build = stage_params(TouchConfig, key), Build(key)
    inputs = build.touch("train"), build.touch("val")
    train, val = (read_npz(path, "images", "points", "angles", "depths", "renderer") for path in inputs)
    data = (
        *(train, val, params.entry.scale, load_profile(sensor_file(params.sensor))),
        lambda: Isosurface(DistanceGrid.from_arrays(read_npz(build.sdf, "values", "band"))),
    )
    train_net(TRAININGS, "touch", key, params.seed, params.settings, data, inputs, log_point)


if __name__ == "__main__":
    run(main, __doc__)
