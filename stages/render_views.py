"""render_views: visual.glb -> views/{train,val,test}.npz, views.png (a contact sheet to look at)."""

import numpy as np
import torch

from objectfolder.base.arrays import write_npz, write_png
from objectfolder.base.figures import tile
from objectfolder.base.seeding import numpy_generator
from objectfolder.mesh.reading.load import AS_STORED, load_mesh
from objectfolder.vision.color import on_white
from objectfolder.vision.renderers.registry import make_renderer
from objectfolder.vision.scene import Scene
from objectfolder.vision.settings import RenderViewsConfig
from objectfolder.vision.truth import draw_frames, render_frames
from objectfolder.workspace.layout import SPLITS, Build
from objectfolder.workspace.params import stage_params
from stages import progress, run


def main(key: str) -> None:
    params = stage_params(RenderViewsConfig, key)
    build, settings = Build(key), params.settings
    scene = Scene(load_mesh(build.visual, "y", AS_STORED), settings.ambient)
    renderer = make_renderer(settings.renderer, scene)
    for split in SPLITS:
        rng = numpy_generator(params.seed, key, "render_views", split)
        views = render_frames(
            renderer,
            draw_frames(scene.mesh.vertices, settings, split, rng),
            settings.train_samples if split == "train" else settings.test_samples,
            rng,
            progress(f"{key}: {split} images"),
            halves=split != "train",
        )
        write_npz(build.views(split), **views)
    shown = on_white(torch.from_numpy(views["rgba"][:24].astype(np.float32)))
    write_png(build.views_sheet, tile((shown.numpy() * 255).round().astype(np.uint8), columns=6))


if __name__ == "__main__":
    run(main, __doc__)
