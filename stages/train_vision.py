"""train_vision: views, visual.glb, sdf.npz -> vision.safetensors, vision_curve.csv."""

import torch

from objectfolder.base.arrays import read_npz, write_safetensors
from objectfolder.base.io import write_curve
from objectfolder.base.seeding import torch_generator
from objectfolder.mesh.grid import DistanceGrid
from objectfolder.mesh.isosurface import Isosurface
from objectfolder.mesh.reading.load import AS_STORED, load_mesh
from objectfolder.nets.checkpoint import INTERVAL, Checkpoint, identity
from objectfolder.nets.fit import Session
from objectfolder.vision.net_settings import VisionConfig
from objectfolder.vision.osf_net import OsfNet
from objectfolder.vision.osf_training import train_osf
from objectfolder.vision.scene import Scene
from objectfolder.vision.surface_net import SurfaceNet
from objectfolder.vision.surface_training import train_surface
from objectfolder.workspace.layout import Build, code_list
from objectfolder.workspace.params import stage_params
from stages import log_point, run


def main(key: str) -> None:
    params = stage_params(VisionConfig, key)
    build, settings = Build(key), params.settings
    train, val = (
        read_npz(build.views(s), "rgba", "camera_to_world", "light", "focal", "center")
        for s in ("train", "val")
    )
    generator = torch_generator(params.seed, key, "train_vision")
    net: SurfaceNet | OsfNet
    if settings.net == "surface":
        surface = Isosurface(DistanceGrid.from_arrays(read_npz(build.sdf, "values", "band")))
        scene = Scene(load_mesh(build.visual, "y", AS_STORED))
        net, curve = train_surface(surface, scene, train, val, settings, Session(generator, report=log_point))
    else:
        # The paper's net takes core-months; where there is a GPU, it trains there.
        device = "cuda" if torch.cuda.is_available() else "cpu"
        inputs = (build.views("train"), build.views("val"), code_list("train_vision"))
        task = identity((settings.osf, params.seed), inputs)
        checkpoint = Checkpoint(build.checkpoint("vision"), task, INTERVAL, replaces=True)
        net, curve = train_osf(train, val, settings.osf, Session(generator, device, checkpoint, log_point))
    tensors, header = net.to_tensors()
    kind = net.kind if isinstance(net, OsfNet) else settings.net
    write_safetensors(build.net("vision"), tensors, {"kind": kind, "net": header})
    write_curve(build.curve("vision"), curve)
    build.checkpoint("vision").unlink(missing_ok=True)


if __name__ == "__main__":
    run(main, __doc__)
