"""evaluate: ObjectFile.safetensors, held-out ground truth -> metrics/<object>.json, vision.png, sound.png."""

import numpy as np

from objectfolder.audio.spectrogram import show_sounds
from objectfolder.figures import page, save_page, show_views
from objectfolder.io import file_digest, read_json, read_npz, write_json
from objectfolder.objectfile.evaluation import (
    Strikes,
    evaluate_gains,
    evaluate_sounds,
    evaluate_touch,
    evaluate_truncation,
    evaluate_vision,
    shown_views,
    strike_sounds,
    view_answers,
)
from objectfolder.objectfile.placed import load_placed
from objectfolder.objectfile.settings import EvaluateConfig
from objectfolder.seeding import numpy_generator
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
    rows = np.flatnonzero(modes["split"] == 2)
    strikes = Strikes.random(rows, params.settings.impacts, rng)
    vision = evaluate_vision(file.view, views)
    metrics = {
        "vision": vision,
        "audio": (evaluate_gains(file, modes, rows) if file.has_modes else {})
        | evaluate_sounds(file, modes, strikes, rng)
        | evaluate_truncation(modes, read_json(build.modal)),
        "touch": evaluate_touch(file, contacts, mean_image),
        "file_bytes": build.object_file.stat().st_size,
        "file_sha256": file_digest(build.object_file),
    }
    write_json(build.metrics, metrics)
    titles = shown_views(vision, SHOWN_VIEWS)
    sheet = page(1.6 * len(titles), 5.8, f"{key}: held-out views")
    show_views(sheet, *view_answers(file, views, list(titles)), list(titles.values()))
    save_page(sheet, build.vision_sheet)
    shown = strikes[:SHOWN]
    sheet = page(3.6 * SHOWN, 9, f"{key}: 1 N s at held-out points of the surface, displacement")
    show_sounds(sheet, *strike_sounds(file, modes, shown), shown.titles(modes["points"] * file.scale))
    save_page(sheet, build.sound_sheet)


if __name__ == "__main__":
    run(main, __doc__)
