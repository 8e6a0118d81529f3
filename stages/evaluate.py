"""evaluate: ObjectFile.safetensors and held-out ground truth -> metrics/<object>.json."""

import numpy as np

from objectfolder.artifacts import Build, read_npz, write_json
from objectfolder.audio.spectrogram import SHAPE
from objectfolder.evaluation import (
    evaluate_audio,
    evaluate_awgn,
    evaluate_spectrograms,
    evaluate_touch,
    evaluate_vision,
)
from objectfolder.objectfile import ObjectFile
from objectfolder.params import stage_params
from objectfolder.seeding import numpy_generator
from stages import run


def main(key: str) -> None:
    params = stage_params("evaluate", key)
    build = Build(key)
    rng = numpy_generator(params.seed, key, "evaluate")
    file = ObjectFile.load(build.object_file)
    views = read_npz(build.views("test"), "rgba", "camera_to_world", "light", "focal")
    modes = read_npz(build.modes, "points", "split", "shapes", "damped_frequency", "damping")
    contacts = read_npz(build.touch("test"), "images", "points", "depths", "angles", "obstructed")
    shapes = {
        "vision": (*views["rgba"].shape[1:3], 3),
        "audio": (*SHAPE, 2),
        "touch": contacts["images"].shape[1:],
    }
    sound = evaluate_audio if file.header["audio"]["kind"] == "gains" else evaluate_spectrograms
    metrics = {
        "vision": evaluate_vision(file, views),
        "audio": sound(file, modes, np.flatnonzero(modes["split"] == 2), params.section.impacts, rng),
        "touch": evaluate_touch(file, contacts, file.tensors["touch.mean_image"]),
        "awgn": evaluate_awgn(shapes, rng),
        "file_bytes": build.object_file.stat().st_size,
    }
    write_json(build.metrics, metrics)


if __name__ == "__main__":
    run(main, __doc__)
