"""Training of an object's nets, whatever their kind."""

import json
from collections.abc import Callable, Iterable
from importlib import import_module
from pathlib import Path
from typing import Any

import torch

from objectfolder.base.arrays import write_safetensors
from objectfolder.base.io import write_curve
from objectfolder.base.seeding import torch_generator
from objectfolder.nets.checkpoint import INTERVAL, Checkpoint, identity
from objectfolder.nets.fit import CurvePoint, Session
from objectfolder.nets.settings import papers_net
from objectfolder.stored.header import require_valid
from objectfolder.workspace.layout import Build, code_list


def train_net(
    trainings: str,
    part: str,
    key: str,
    seed: int,
    settings: Any,
    data: tuple[Any, ...],
    inputs: Iterable[Path],
    report: Callable[[CurvePoint], None],
    **described: Any,
) -> None:
    """Train the net of a part of an object by the module of its kind, and write the stage's outputs.

    ``trainings`` names these modules, such as ``objectfolder.touch.*_training``; each has a function
    ``train(*data, settings, session)`` that returns net and curve. ``data`` is from the files ``inputs``.
    ``described`` is written beside the net's header. Raises ObjectFolderError if that breaks the schema.

    The paper's nets take core-days: they train on a GPU where there is one, and continue when killed.
    """
    build, stage, checkpoint, device = Build(key), f"train_{part}", None, "cpu"
    if (own := papers_net(settings, settings.net)) is not None:
        device = "cuda" if torch.cuda.is_available() else "cpu"
        task = identity((own, seed), (*inputs, code_list(stage)))
        checkpoint = Checkpoint(build.checkpoint(part), task, INTERVAL, replaces=True)
    session = Session(torch_generator(seed, key, stage), device, checkpoint, report)
    net, curve = import_module(trainings.replace("*", settings.net)).train(*data, settings, session)
    tensors, header = net.to_tensors()
    kind = getattr(net, "kind", settings.net)
    described = {"kind": kind, "net": header, **described}
    require_valid(
        json.loads(json.dumps(described)),
        import_module(type(net).__module__).KINDS[kind].schema,
        key,
        (part,),
    )
    write_safetensors(build.net(part), tensors, described)
    write_curve(build.curve(part), curve)
    build.checkpoint(part).unlink(missing_ok=True)
