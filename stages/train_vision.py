"""train_vision: views, sdf.npz -> vision.safetensors, vision_curve.csv."""

from objectfolder.artifacts import Build, read_npz, write_curve, write_safetensors
from objectfolder.mesh.grid import DistanceGrid
from objectfolder.mesh.isosurface import Isosurface
from objectfolder.nets.vision_surface import VisionConfig, train_surface
from objectfolder.params import stage_params
from objectfolder.seeding import torch_generator
from stages import log_point, run


def main(key: str) -> None:
    params = stage_params("train_vision", key)
    build, section = Build(key), params.section
    surface = Isosurface(DistanceGrid.from_arrays(read_npz(build.sdf, "values", "band")))
    train, val = (
        read_npz(build.views(s), "rgba", "camera_to_world", "light", "focal") for s in ("train", "val")
    )
    config = VisionConfig(**section.model_dump(exclude={"net"}))
    generator = torch_generator(params.seed, key, "train_vision")
    net, curve = train_surface(surface, train, val, config, generator, log_point)
    tensors, header = net.to_tensors()
    write_safetensors(build.net("vision"), tensors, {"kind": section.net, "net": header})
    write_curve(build.curve("vision"), curve)


if __name__ == "__main__":
    run(main, __doc__)
