"""Draw docs/turntable.webp, three samples that turn under a studio's light: `python docs/turntable.py`."""

from pathlib import Path

import numpy as np
from PIL import Image

from objectfolder import ObjectFile
from objectfolder.base.io import atomic
from objectfolder.objectfile.samples import available_samples
from objectfolder.objectfile.turntable import Turntable
from objectfolder.vision.lighting import studio

FRAMES, SIZE, MILLISECONDS = 48, 224, 80


def main() -> None:
    objects = [ObjectFile.sample(name) for name in reversed(available_samples())]
    seconds = MILLISECONDS / 1000 * np.arange(FRAMES + 1)
    turntable = Turntable(seconds=seconds[-1], size=SIZE)
    frames = []
    for second in seconds[:-1]:
        camera, lights = turntable.camera(second), studio(turntable.light(second))
        images = [file.view(camera, resolution=SIZE, lights=lights)[0] for file in objects]
        frames.append(Image.fromarray((np.concatenate(images, 1) * 255).round().astype(np.uint8)))
    with atomic(Path(__file__).parent / "turntable.webp") as path:
        frames[0].save(
            path, "WEBP", save_all=True, append_images=frames[1:], duration=MILLISECONDS, loop=0, quality=70
        )


if __name__ == "__main__":
    main()
