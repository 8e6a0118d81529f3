"""train_touch: touches, sdf.npz, sensor profile -> touch.safetensors, touch_curve.csv."""

import torch

from objectfolder.base.arrays import read_npz, write_safetensors
from objectfolder.base.io import write_curve
from objectfolder.base.seeding import torch_generator
from objectfolder.mesh.grid import DistanceGrid
from objectfolder.mesh.isosurface import Isosurface
from objectfolder.nets.checkpoint import INTERVAL, Checkpoint, identity
from objectfolder.nets.fit import Session
from objectfolder.touch.geometric_net import GeometricTouch
from objectfolder.touch.geometric_training import fit_contacts
from objectfolder.touch.image_net import ImageTouch
from objectfolder.touch.image_training import train_image
from objectfolder.touch.net_settings import TouchConfig
from objectfolder.touch.profiles import load_profile
from objectfolder.workspace.installed import sensor_file
from objectfolder.workspace.layout import Build, code_list
from objectfolder.workspace.params import stage_params
from stages import log_point, run

ROWS = ("images", "points", "angles", "depths")


def main(key: str) -> None:
    params = stage_params(TouchConfig, key)
    build, settings, scale = Build(key), params.settings, params.entry.scale
    profile = load_profile(sensor_file(params.sensor))
    train, val = (read_npz(build.touch(split), *ROWS, "renderer") for split in ("train", "val"))
    net: GeometricTouch | ImageTouch
    if settings.net == "geometric":
        surface = Isosurface(DistanceGrid.from_arrays(read_npz(build.sdf, "values", "band")))
        net = GeometricTouch(surface, scale, profile, renderer=str(train["renderer"]))
        some = [{name: split[name][: settings.contacts] for name in ROWS} for split in (train, val)]
        curve = fit_contacts(net, some[0], some[1], settings.offset_span, settings.rounds, log_point)
    else:
        # The paper's net takes core-days; where there is a GPU, it trains there.
        generator = torch_generator(params.seed, key, "train_touch")
        device = "cuda" if torch.cuda.is_available() else "cpu"
        inputs = (build.touch("train"), build.touch("val"), code_list("train_touch"))
        task = identity((settings.image, params.seed), inputs)
        checkpoint = Checkpoint(build.checkpoint("touch"), task, INTERVAL, replaces=True)
        session = Session(generator, device, checkpoint, log_point)
        net, curve = train_image(train, val, scale, profile.name, settings.image, session)
    tensors, header = net.to_tensors()
    write_safetensors(build.net("touch"), tensors, {"kind": settings.net, "net": header})
    write_curve(build.curve("touch"), curve)
    build.checkpoint("touch").unlink(missing_ok=True)


if __name__ == "__main__":
    run(main, __doc__)
