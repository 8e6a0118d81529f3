"""train_audio: modes.npz -> audio.safetensors, audio_curve.csv."""

import numpy as np

from objectfolder.artifacts import Build, read_npz, write_curve, write_safetensors
from objectfolder.nets.audio_gains import AudioConfig, train_gains
from objectfolder.params import stage_params
from objectfolder.seeding import torch_generator
from stages import log_point, run


def main(key: str) -> None:
    params = stage_params("train_audio", key)
    build, section = Build(key), params.section
    modes = read_npz(
        build.modes, "points", "split", "shapes", "damped_frequency", "damping", "truncated", "band_hz"
    )
    size = section.size(len(modes["damping"]))
    config = AudioConfig(
        size.width, size.depth, size.frequency, section.steps, section.batch, section.learning_rate
    )
    net, curve = train_gains(
        modes["points"],
        modes["shapes"],
        modes["damped_frequency"],
        modes["damping"],
        np.flatnonzero(modes["split"] == 0),
        np.flatnonzero(modes["split"] == 1),
        config,
        torch_generator(params.seed, key, "train_audio"),
        log_point,
    )
    tensors, header = net.to_tensors()
    write_safetensors(
        build.net("audio"),
        tensors,
        {
            "kind": section.net,
            "net": header,
            "truncated": bool(modes["truncated"]),
            "band_hz": modes["band_hz"].tolist(),
        },
    )
    write_curve(build.curve("audio"), curve)


if __name__ == "__main__":
    run(main, __doc__)
