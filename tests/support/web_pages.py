"""What pages hold, and browsers to try them in."""

import base64
import io
import json
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
import soundfile
from PIL import Image

VIEWER = Path(__file__).parents[2] / "viewer"
_FOUND = shutil.which("node") and shutil.which("chromium") and (VIEWER / "node_modules").exists()
NEEDS_CHROMIUM = pytest.mark.skipif(not _FOUND, reason="needs node, `npm ci` in viewer/ and Chromium")


def run_node(script, *arguments):
    """Run a script of viewer/tests in node; return what it prints."""
    command = ["node", f"tests/{script}", *map(str, arguments)]
    done = subprocess.run(command, cwd=VIEWER, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


def page_data(page, attributes):
    """JSON that a page holds in a script element."""
    return json.loads(re.search(rf'<script type="application/json" {attributes}>(.*?)</script>', page)[1])


def check_whole(page):
    """Check that a page loads nothing."""
    without = re.sub(r"<script.*?</script>", "", page, flags=re.S)
    assert not re.search(r"""(src|href)=["'](?!data:|#)""", without)


def heard(uri):
    """Sound of a data URI, and its sample rate."""
    return soundfile.read(io.BytesIO(base64.b64decode(uri.partition(",")[2])))


def seen(uri):
    """Picture of a data URI, (H, W, 3) uint8."""
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(uri.partition(",")[2]))).convert("RGB"))
