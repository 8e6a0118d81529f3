"""Procedural objects of the tests, and digests of their files."""

import hashlib
import json
import sys
import tempfile
from pathlib import Path
from typing import Any

from objectfolder.shapes import generate
from objectfolder.shapes.toy import KINDS
from objectfolder.workspace import params

ROOT = Path(__file__).parents[2]
CATALOGUE = ROOT / "catalogs/procedural.yaml"
THIN = ROOT / "catalogs/thin.yaml"
SMALL = 256  # texels: most tests examine the geometry

FURNITURE: dict[str, tuple[str, dict[str, Any]]] = {
    "dining table": ("table", {}),
    "oval low table": ("table", {"length": 1.2, "height": 0.45, "shape": "oval", "apron": 0}),
    "pillar table": ("table", {"length": 0.9, "width": 0.9, "shape": "oval", "base": "pillar"}),
    "steel desk": ("table", {"overhang": 0, "bevel": 0, "taper": 1.0, "finish": "brushed"}),
    "stool": ("stool", {}),
    "milking stool": ("stool", {"height": 0.28, "legs": 3, "rung_height": 0}),
    "bookcase": ("shelf", {}),
    "rack": ("shelf", {"back": 0, "bays": 2, "finish": "plastic", "color": "3d6b4f"}),
    "cabinet": ("shelf", {"front": "doors", "depth": 0.4, "bays": 2}),
    "chest of drawers": ("shelf", {"front": "drawers", "depth": 0.4, "height": 0.85, "bays": 3}),
}
CLUB: dict[str, Any] = {"head": "club", "head_length": 0.1, "head_diameter": 0.042, "length": 0.24}
CLUB |= {"handle_width": 0.032}
MALLET: dict[str, Any] = {"head": "mallet", "head_length": 0.13, "head_diameter": 0.075, "length": 0.28}
MALLET |= {"finish": "wood"}
LADLE: dict[str, Any] = {"length": 0.16, "bowl_length": 0.09, "bowl_width": 0.088, "depth": 0.045}
LADLE |= {"wall": 0.002, "handle_width": 0.02, "rise": 0.2, "hook": 0.018, "point": 0}
TOOLS: dict[str, tuple[str, dict[str, Any]]] = {
    "wrench": ("wrench", {}),
    "open wrench": ("wrench", {"ends": "open", "finish": "cast"}),
    "ring wrench": ("wrench", {"ends": "ring"}),
    "claw hammer": ("hammer", {"accent": "b23a2a"}),
    "club hammer": ("hammer", CLUB),
    "mallet": ("hammer", MALLET),
    "spoon": ("spoon", {}),
    "ladle": ("spoon", LADLE),
    "peg block": ("block", {}),
    "shape sorter": ("block", {"depth": 0.025, "hole": "mixed", "rounding": 0.001}),
    "plain block": ("block", {"relief": "plain", "finish": "print"}),
    "airplane": ("airplane", {}),
    "brick": ("block", {"relief": "studs", "rounding": 0.001, "finish": "plastic"}),
    **{kind: ("toy", {"kind": kind}) for kind in ("car", "truck", "duck", "rings")},
}
APPLIANCES: dict[str, tuple[str, dict[str, Any]]] = {
    "television": ("electronics", {"kind": "television", "finish": "brushed"}),
    "radio": ("electronics", {"kind": "radio", "finish": "wood"}),
    "clock": ("electronics", {"kind": "clock"}),
    "toaster": ("appliance", {"kind": "toaster", "finish": "brushed"}),
    "lantern": ("appliance", {"kind": "lantern", "finish": "cast"}),
    "clothes iron": ("appliance", {"kind": "iron"}),
    "hair dryer": ("appliance", {"kind": "dryer"}),
}
STARTERS = ("mug", "die", "bell")
VESSELS = ("bowl", "cup", "plate", "bottle", "vase", "pan", "teapot")
CASES = {name: (name, {}) for name in STARTERS} | {name: (name, {"seed": 3}) for name in VESSELS}
CASES |= FURNITURE | TOOLS | APPLIANCES
SAMPLE = ("toaster", "lantern")  # of the appliances, examined by default
#: Handles and holes of each object, such as the slots of a radio; furniture and toys have no designed number.
GENUS = dict.fromkeys((*STARTERS, *VESSELS, *TOOLS), 0) | dict.fromkeys(KINDS)
GENUS |= {"mug": 1, "pan": 1, "teapot": 1, "wrench": 1, "ring wrench": 2, "peg block": 9, "television": 4}
GENUS |= {"radio": 10, "clock": 1, "toaster": 1, "lantern": 13, "clothes iron": 1, "hair dryer": 4}


def digests(collection: str) -> dict[str, str]:
    """Generate objects and return the digests of their files.

    ``collection``: the first case of each generator, all cases, or the objects of the catalogues.
    """
    cases = CASES
    if collection == "generators":
        first = {case[0]: (name, case) for name, case in reversed(CASES.items())}
        cases = dict(first.values())
    if collection == "catalogue":
        both = (CATALOGUE, THIN)
        cases = {key: params.procedural_entry(key, c) for c in both for key in params.read(c)["procedural"]}
    found = {}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "object.glb"
        for name, (generator, parameters) in cases.items():
            generate(generator, **parameters | {"texture_size": SMALL}).write_glb(path)
            found[name] = hashlib.sha256(path.read_bytes()).hexdigest()
    return found


if __name__ == "__main__":
    print(json.dumps(digests(sys.argv[1])))
