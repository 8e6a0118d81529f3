"""Stages query the paper's VisionNet on a GPU, and every other net on the CPU."""

from types import SimpleNamespace

import pytest
import torch

from objectfolder.objectfile import file


@pytest.mark.parametrize(
    ("header", "gpu", "device"),
    [
        ({"vision": {"kind": "osf_hull"}}, True, "cuda"),
        ({"vision": {"kind": "osf"}}, True, "cuda"),
        ({"vision": {"kind": "osf"}}, False, "cpu"),
        ({"vision": {"kind": "surface"}}, True, "cpu"),
        ({}, True, "cpu"),
    ],
)
def test_the_vision_net_chooses_the_device(monkeypatch, header, gpu, device):
    def load(path, device="cpu"):
        return SimpleNamespace(header=header, device=device)

    monkeypatch.setattr(file.ObjectFile, "load", load)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: gpu)
    assert file.load_placed("a").device == device
