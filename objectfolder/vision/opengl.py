"""OpenGL without a window, by pyrender."""

import atexit
import os
from functools import cache

import numpy as np

# By default pyrender opens a window; it also uses a name that numpy 2 has dropped.
os.environ.setdefault("PYOPENGL_PLATFORM", "egl")
vars(np).setdefault("infty", np.inf)

import pyrender  # noqa: E402
from OpenGL.error import Error as OpenGLError  # noqa: E402


@cache
def canvas() -> "pyrender.OffscreenRenderer":
    """Return the canvas shared by all renderers: deleting one ends OpenGL for the others.

    Raises ImportError if OpenGL cannot draw here without a window.
    """
    try:
        offscreen = pyrender.OffscreenRenderer(1, 1)
    except (OpenGLError, RuntimeError, ValueError) as error:
        raise ImportError(f"OpenGL does not start: {error}") from error
    atexit.register(offscreen.delete)
    return offscreen
