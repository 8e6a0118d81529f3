"""train_audio: modes.npz -> audio.safetensors, audio_curve.csv."""

from collections.abc import Callable
from typing import Any

import numpy as np
import torch

from objectfolder.io import read_npz, write_curve, write_safetensors
from objectfolder.nets.audio_gains import AudioConfig, train_gains
from objectfolder.nets.audio_spectrogram import SpectrogramConfig, train_spectrogram
from objectfolder.seeding import torch_generator
from objectfolder.workspace.layout import Build
from objectfolder.workspace.params import stage_params
from stages import log_point, run


def main(key: str) -> None:
    params = stage_params("train_audio", key)
    build, section = Build(key), params.section
    modes = read_npz(
        build.modes, "points", "split", "shapes", "damped_frequency", "damping", "truncated", "band_hz"
    )
    generator = torch_generator(params.seed, key, "train_audio")

    def fitted(train: Callable[..., Any], config: AudioConfig | SpectrogramConfig, **options: Any) -> Any:
        return train(
            modes["points"],
            modes["shapes"],
            modes["damped_frequency"],
            modes["damping"],
            np.flatnonzero(modes["split"] == 0),
            np.flatnonzero(modes["split"] == 1),
            config,
            generator,
            log_point,
            **options,
        )

    if section.net == "gains":
        size = section.size(len(modes["damping"])).model_dump(exclude={"modes"})
        config = AudioConfig(**size, batch=section.batch)
        net, curve = fitted(train_gains, config)
    else:
        # The paper's net takes core-days; where there is a GPU, it trains there.
        device = "cuda" if torch.cuda.is_available() else "cpu"
        settings = SpectrogramConfig(**section.spectrogram.model_dump())
        net, curve = fitted(train_spectrogram, settings, device=device)
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
