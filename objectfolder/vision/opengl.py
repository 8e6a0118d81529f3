"""OpenGL without a window, by pyrender."""

import atexit
import os
from functools import cache

import numpy as np

# pyrender opens a window unless told otherwise, and uses a name that numpy 2 has dropped.
os.environ.setdefault("PYOPENGL_PLATFORM", "egl")
vars(np).setdefault("infty", np.inf)

import pyrender  # noqa: E402
from OpenGL.error import Error as OpenGLError  # noqa: E402


@cache
def canvas() -> "pyrender.OffscreenRenderer":
    """One for all renderers: to delete one ends OpenGL for the others.

    Raises
    ------
    ImportError
        If OpenGL cannot draw here without a window.
    """
    try:
        offscreen = pyrender.OffscreenRenderer(1, 1)
    except (OpenGLError, RuntimeError, ValueError) as error:
        raise ImportError(f"OpenGL does not start: {error}") from error
    atexit.register(offscreen.delete)
    return offscreen
