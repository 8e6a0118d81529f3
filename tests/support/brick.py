"""A small but real Object File."""

import numpy as np
import torch
from solids import box

from objectfolder.base.materials import material
from objectfolder.mesh.normalize import mass_properties
from objectfolder.mesh.sampling import sample_surface
from objectfolder.mesh.sdf import distance_grid
from objectfolder.nets.fit import Session
from objectfolder.nets.hashgrid import HashGrid
from objectfolder.objectfile.file import ObjectFile
from objectfolder.objectfile.packing import pack_object_file
from objectfolder.sound.fem.cutcell import cut_cells
from objectfolder.sound.fem.modal import Request, modal_analysis, solved_band
from objectfolder.sound.gains_training import ModeSamples, train_gains
from objectfolder.sound.net_settings import GainsConfig
from objectfolder.sound.radiation.radiation import pack_radiation, radiate
from objectfolder.sound.spectrogram_net import SpectrogramNet
from objectfolder.touch.geometric_net import GeometricTouch
from objectfolder.touch.image_net import ImageTouch
from objectfolder.touch.profiles import load_profile
from objectfolder.vision.surface_net import SurfaceNet

SIDES = (1.0, 0.6, 0.3)
SCALE = 0.1


def with_images(brick: ObjectFile, depth: float, angle: float) -> ObjectFile:
    """The brick with an untrained touch net of images, which knows one press alone."""
    net = ImageTouch("digit", (6, 4), (depth, angle), width=8, depth=2, point_octaves=2, pixel_octaves=2)
    images, config = net.to_tensors()
    tensors = {name: value for name, value in brick.tensors.items() if not name.startswith("touch.")}
    tensors |= {f"touch.{name}": value for name, value in images.items()}
    return ObjectFile(brick.header | {"touch": {"kind": "image", "net": config}}, tensors)


def without(file: ObjectFile, part: str) -> ObjectFile:
    """The same Object File without one of its parts."""
    tensors = {name: value for name, value in file.tensors.items() if not name.startswith(f"{part}.")}
    return ObjectFile({name: value for name, value in file.header.items() if name != part}, tensors)


def build_brick(scale=SCALE, steps=40) -> ObjectFile:
    """A brick of plastic whose parts are real but small: its look is random, its sound nearly right."""
    solid = box(SIDES)
    size = {"modes": 12, "resolution": 4, "channels": 4, "width": 24, "features": 24, "most_features": 24}
    config = GainsConfig(**size, frequency=3.0, steps=steps, learning_rate=3e-3, grid_rate=3.0)
    request = Request(material("plastic"), scale, 20000.0, 12)
    return build_small("brick", solid, cut_cells(*solid, 6, 4), request, config, 300, 300)


def build_small(key, solid, cells, request, config, points, directions) -> ObjectFile:
    """An Object File of a closed mesh, by the functions of the stages, from few points of its surface."""
    scale, stuff = request.scale, request.material
    values, band = distance_grid(*solid, 64)
    points = sample_surface(*solid, points, np.random.default_rng(0))
    modes = modal_analysis(cells, points, request)
    band_hz = solved_band(modes, request)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        grid = HashGrid(levels=2, features=2, table_bits=10, coarsest=4, finest=12)
        look = SurfaceNet(grid, width=8, roughness=0.5, metallic=0.0)
    samples = ModeSamples(
        *(points, modes.shapes, modes.damped_frequency, modes.damping),
        train=np.arange(len(points) - 50),
        val=np.arange(len(points) - 50, len(points)),
    )
    sound, _ = train_gains(samples, config, 128, Session(torch.Generator().manual_seed(0)))
    surface = solid[0] * scale, solid[1]
    radiation = None
    if directions:
        sound_field = radiate(surface, points * scale, modes.shapes, modes.damped_frequency, directions)
        radiation = pack_radiation(sound_field, surface, scale, 56000)
    look_tensors, look_config = look.to_tensors()
    sound_tensors, sound_config = sound.to_tensors()
    profile = load_profile("digit")
    feel_config = {"sensor": profile.to_dict(), "depth_offset": 0.0, "renderer": "gel", "smoothing": 0}
    header, tensors = pack_object_file(
        key,
        {"material": stuff.name, "material_properties": stuff.properties(), "scale_m": scale},
        {
            **{"source_centre": [0, 0, 0], "source_size": 1.0, "source_up": "z"},
            "solid": mass_properties(solid),
        },
        {"values": values, "band": np.float64(band)},
        {
            "vision": (look_tensors, {"kind": "surface", "net": look_config}),
            "audio": (sound_tensors, {"kind": "gains", "net": sound_config, "band_hz": band_hz}),
            "touch": ({}, {"kind": "geometric", "net": feel_config}),
        },
        {"sdf": "0" * 64},
        radiation,
    )
    return ObjectFile(header, tensors, key)


def with_spectrograms(file: ObjectFile) -> ObjectFile:
    """The same object with an audio net that stores spectrograms, of noise."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        net = SpectrogramNet(
            file._parts.audio.damped_frequency, torch.tensor([[-1e-4, 2e-4]] * 3), 16, 2, 2, 3
        )
        for branch in net.branches:
            torch.nn.init.normal_(branch.output.weight, std=1.0)
    tensors, config = net.to_tensors()
    others = {name: t for name, t in file.tensors.items() if not name.startswith("audio.")}
    header = {**file.header, "audio": {"kind": "spectrogram", "net": config, "truncated": False}}
    return ObjectFile(header, others | {f"audio.{name}": t for name, t in tensors.items()}, file.key)


def felt_by(file: ObjectFile, sensor: str) -> ObjectFile:
    """The same object with another stored sensor."""
    tensors, config = GeometricTouch(file.surface, file.scale, load_profile(sensor)).to_tensors()
    header = file.header | {"touch": {"kind": "geometric", "net": config}}
    return ObjectFile(header, {**file.tensors, **{f"touch.{name}": t for name, t in tensors.items()}})
