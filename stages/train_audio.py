"""train_audio: modes.npz -> audio.safetensors, audio_curve.csv."""

import numpy as np
import torch

from objectfolder.base.arrays import read_npz, write_safetensors
from objectfolder.base.io import write_curve
from objectfolder.base.seeding import torch_generator
from objectfolder.nets.checkpoint import INTERVAL, Checkpoint, identity
from objectfolder.nets.fit import Session
from objectfolder.sound.gains_net import GainsNet
from objectfolder.sound.gains_training import ModeSamples, train_gains
from objectfolder.sound.net_settings import AudioConfig
from objectfolder.sound.spectrogram_net import SpectrogramNet
from objectfolder.sound.spectrogram_training import train_spectrogram
from objectfolder.workspace.layout import Build, code_list
from objectfolder.workspace.params import stage_params
from stages import log_point, run


def main(key: str) -> None:
    params = stage_params(AudioConfig, key)
    build, settings = Build(key), params.settings
    modes = read_npz(
        build.modes, "points", "split", "shapes", "damped_frequency", "damping", "truncated", "band_hz"
    )
    generator = torch_generator(params.seed, key, "train_audio")

    samples = ModeSamples(
        **{name: modes[name] for name in ("points", "shapes", "damped_frequency", "damping")},
        train=np.flatnonzero(modes["split"] == 0),
        val=np.flatnonzero(modes["split"] == 1),
    )
    net: GainsNet | SpectrogramNet
    if settings.net == "gains":
        size = settings.size(len(modes["damping"]))
        net, curve = train_gains(samples, size, settings.batch, Session(generator, report=log_point))
    else:
        # The paper's net takes core-days; where there is a GPU, it trains there.
        device = "cuda" if torch.cuda.is_available() else "cpu"
        inputs = (build.modes, code_list("train_audio"))
        task = identity((settings.spectrogram, params.seed), inputs)
        checkpoint = Checkpoint(build.checkpoint("audio"), task, INTERVAL, replaces=True)
        session = Session(generator, device, checkpoint, log_point)
        net, curve = train_spectrogram(samples, settings.spectrogram, session)
    tensors, header = net.to_tensors()
    write_safetensors(
        build.net("audio"),
        tensors,
        {
            "kind": settings.net,
            "net": header,
            "truncated": bool(modes["truncated"]),
            "band_hz": modes["band_hz"].tolist(),
        },
    )
    write_curve(build.curve("audio"), curve)
    build.checkpoint("audio").unlink(missing_ok=True)


if __name__ == "__main__":
    run(main, __doc__)
