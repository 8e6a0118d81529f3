"""train_touch: touches, sdf.npz, sensor profile -> touch.safetensors, touch_curve.csv."""

import numpy as np

from objectfolder.artifacts import Build, read_npz, write_curve, write_safetensors
from objectfolder.mesh.grid import DistanceGrid
from objectfolder.mesh.isosurface import Isosurface
from objectfolder.nets.touch_geometric import GeometricTouch, fit_depth_offset
from objectfolder.params import stage_params
from objectfolder.touch.profiles import load_profile
from stages import log_point, run


def main(key: str) -> None:
    params = stage_params("train_touch", key)
    build, section = Build(key), params.section
    surface = Isosurface(DistanceGrid.from_arrays(read_npz(build.sdf, "values", "band")))
    net = GeometricTouch(surface, params.object.scale, load_profile(params.sensor))
    images = read_npz(build.touch("train"), "images")["images"]
    train, val = (
        {name: rows[: section.contacts] for name, rows in read_npz(build.touch(split)).items()}
        for split in ("train", "val")
    )
    curve = fit_depth_offset(net, train, val, section.offset_span, section.rounds, log_point)
    # The mean training image is the baseline that evaluation prints beside the score.
    mean = images.mean(0, dtype=np.float64).round().astype(np.uint8)
    header = {"kind": section.net, "net": net.config()}
    write_safetensors(build.net("touch"), {"mean_image": mean}, header)
    write_curve(build.curve("touch"), curve)


if __name__ == "__main__":
    run(main, __doc__)
