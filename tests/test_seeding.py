import torch

from objectfolder.base.seeding import numpy_generator, torch_generator


def test_streams_depend_on_seed_object_and_purpose_only():
    purposes = [(0, "mug", "modal"), (1, "mug", "modal"), (0, "die", "modal"), (0, "mug", "net"), (0, "mug")]
    first = [numpy_generator(*p).random() for p in purposes]
    assert len(set(first)) == len(purposes)
    assert [numpy_generator(*p).random() for p in purposes] == first
    tensors = [torch.rand(1, generator=torch_generator(*p)).item() for p in purposes]
    assert len(set(tensors)) == len(purposes)
    assert [torch.rand(1, generator=torch_generator(*p)).item() for p in purposes] == tensors
