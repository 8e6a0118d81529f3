"""The device on which a stage queries an Object File."""

from pathlib import Path

import torch

from objectfolder.objectfile.file import ObjectFile
from objectfolder.objectfile.vision import OSF_KINDS


def load_placed(path: str | Path) -> ObjectFile:
    """Load an Object File for many queries: one with the paper's VisionNet on a GPU, if torch finds one.

    That net takes minutes for a view on a CPU. All others stay on the CPU, where they answer the same bytes
    with a GPU and without.
    """
    file = ObjectFile.load(path)
    slow = file.header.get("vision", {}).get("kind") in OSF_KINDS
    return ObjectFile.load(path, "cuda") if slow and torch.cuda.is_available() else file
