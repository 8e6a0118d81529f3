"""evaluate: ObjectFile.safetensors, held-out ground truth -> metrics/<object>.json, vision.png, sound.png."""

import numpy as np

from objectfolder.base.arrays import read_npz
from objectfolder.base.figures import page, save_page
from objectfolder.base.io import file_digest, read_json, write_json
from objectfolder.base.seeding import numpy_generator
from objectfolder.objectfile.file import load_placed
from objectfolder.objectfile.settings import EvaluateConfig
from objectfolder.report.comparison import show_sounds, show_views, shown_rate
from objectfolder.sound.evaluation import SoundTruth, UnitStrikes, compare_sounds, evaluate_sound
from objectfolder.touch.evaluation import evaluate_touch
from objectfolder.vision.evaluation import choose_views, compare_views, evaluate_vision
from objectfolder.workspace.layout import Build
from objectfolder.workspace.params import stage_params
from stages import run

SHOWN = 4  # strikes whose spectrograms are drawn
SHOWN_VIEWS = 6


def main(key: str) -> None:
    params = stage_params(EvaluateConfig, key)
    build = Build(key)
    rng = numpy_generator(params.seed, key, "evaluate")
    file = load_placed(build.object_file)
    views = read_npz(build.views("test"), "rgba", "camera_to_world", "light", "focal", "center", "noise")
    modes = read_npz(build.modes, "points", "split", "shapes", "damped_frequency", "damping")
    contacts = read_npz(
        build.touch("test"), "images", "masks", "points", "depths", "angles", "obstructed", "force"
    )
    # The baseline of touch: what knows the training images but not the contact.
    mean_image = read_npz(build.touch("train"), "images")["images"].mean(0, dtype=np.float64).round()
    strikes = UnitStrikes.random(np.flatnonzero(modes["split"] == 2), params.settings.impacts, rng)
    vision = evaluate_vision(file, views)
    metrics = {
        "vision": vision,
        "audio": evaluate_sound(file, SoundTruth(modes, read_json(build.modal), strikes, rng)),
        "touch": evaluate_touch(file, contacts | {"mean_image": mean_image}),
        "file_bytes": build.object_file.stat().st_size,
        "file_sha256": file_digest(build.object_file),
    }
    write_json(build.metrics, metrics)
    titles = choose_views(vision, views["rgba"], SHOWN_VIEWS)
    sheet = page(1.6 * len(titles), 5.8, f"{key}: held-out views")
    show_views(sheet, *compare_views(file, views, list(titles)), list(titles.values()))
    save_page(sheet, build.vision_sheet)
    shown, rate = strikes[:SHOWN], shown_rate(file)
    sheet = page(3.6 * SHOWN, 9, f"{key}: 1 N s at held-out points of the surface, displacement")
    sounds = compare_sounds(file, modes, shown, rate)
    show_sounds(sheet, *sounds, rate, shown.describe(modes["points"] * file.scale))
    save_page(sheet, build.sound_sheet)


if __name__ == "__main__":
    run(main, __doc__)
