"""train_audio: modes.npz -> audio.safetensors, audio_curve.csv."""

import numpy as np

from objectfolder.base.arrays import read_npz
from objectfolder.sound.gains_training import ModeSamples
from objectfolder.sound.net_settings import AudioConfig
from objectfolder.workspace.layout import Build
from objectfolder.workspace.params import stage_params
from objectfolder.workspace.training import train_net
from stages import log_point, run

TRAININGS = "objectfolder.sound.*_training"


def main(key: str) -> None:
    params, build = stage_params(AudioConfig, key), Build(key)
    names = "points", "shapes", "damped_frequency", "damping"
    modes = read_npz(build.modes, *names, "split", "truncated", "band_hz")
    samples = ModeSamples(
        **{name: modes[name] for name in names},
        train=np.flatnonzero(modes["split"] == 0),
        val=np.flatnonzero(modes["split"] == 1),
    )
    train_net(
        *(TRAININGS, "audio", key, params.seed, params.settings, (samples,), (build.modes,), log_point),
        truncated=bool(modes["truncated"]),
        band_hz=modes["band_hz"].tolist(),
    )


if __name__ == "__main__":
    run(main, __doc__)
