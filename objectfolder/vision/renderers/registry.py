"""Registry of the renderers, and their common interface."""

from collections.abc import Callable
from functools import partial
from typing import Protocol

import numpy as np

from objectfolder.base.errors import ObjectFolderError
from objectfolder.vision.cameras import Intrinsics
from objectfolder.vision.scene import Scene


class Renderer(Protocol):
    """Renderer of one scene from any camera under any point light."""

    version: str  #: program, version and variant, recorded with the views

    def render(
        self, camera_to_world: np.ndarray, light: np.ndarray, intrinsics: Intrinsics, samples: int, seed: int
    ) -> np.ndarray:
        """Render one view; (H, W, 4) float32, finite, linear, premultiplied by alpha.

        The camera (4, 4), in OpenGL axes, may be inside the object, and the point light (3,) anywhere, also
        on the surface; both in the unit frame. Samples are per pixel; the same seed of them gives the same
        image.
        """
        ...


def _mitsuba(scene: Scene, variant: str) -> Renderer:
    from objectfolder.vision.renderers.mitsuba import MitsubaRenderer

    return MitsubaRenderer(scene, variant)


def _cycles(scene: Scene) -> Renderer:
    from objectfolder.vision.renderers.cycles import CyclesRenderer

    return CyclesRenderer(scene)


def _raster(scene: Scene) -> Renderer:
    from objectfolder.vision.renderers.raster import RasterRenderer

    return RasterRenderer(scene)


#: Constructor of each renderer; ``RendererName`` of `objectfolder.vision.settings` lists the same names.
RENDERERS: dict[str, Callable[[Scene], Renderer]] = {
    "mitsuba": partial(_mitsuba, variant="scalar_rgb"),
    "mitsuba-llvm": partial(_mitsuba, variant="llvm_ad_rgb"),
    "mitsuba-cuda": partial(_mitsuba, variant="cuda_ad_rgb"),
    "cycles": _cycles,
    "raster": _raster,
}
#: What to install for each renderer.
NEEDS = {
    "mitsuba": "the extra build",
    "mitsuba-llvm": "the extra build and an LLVM library, version 19 or newer (libllvm19)",
    "mitsuba-cuda": "the extra build on a machine with an NVIDIA GPU and its driver",
    "cycles": "the extra cycles (Python 3.11), or Blender 4.2 or newer on the PATH",
    "raster": "the extra raster and EGL (libegl1) or OSMesa (PYOPENGL_PLATFORM=osmesa)",
}


def make_renderer(name: str, scene: Scene) -> Renderer:
    """Make a renderer by name.

    Raises ObjectFolderError if there is no such renderer, or it is not installed, and says what to install.
    """
    if name not in RENDERERS:
        raise ObjectFolderError(f"renderer {name!r} is not one of {', '.join(RENDERERS)}")
    try:
        return RENDERERS[name](scene)
    except ImportError as error:
        raise ObjectFolderError(
            f"renderer {name!r} cannot run here ({error}): install {NEEDS[name]}, as `objectfolder doctor` "
            "says, or set render_views.renderer to another"
        ) from error
