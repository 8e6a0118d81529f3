"""Subgraph of DVC's graph for given targets, in a deterministic order."""

import difflib
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import networkx as nx
from dvc.repo.reproduce import get_active_graph
from dvc.stage import PipelineStage, Stage

from objectfolder.base.errors import ObjectFolderError, shortened
from objectfolder.engine.dvc.repository import OpenRepository
from objectfolder.engine.summary import NO_OBJECTS
from objectfolder.workspace.stages import ON_DEMAND, TASKS


@dataclass(frozen=True)
class StageGraph:
    """Targets and everything upstream of them."""

    stages: dict[str, Stage]  #: DVC stages by address, upstream first
    #: Addresses of the direct upstream stages of every stage, in the same order.
    upstream: dict[str, set[str]]


def stage_graph(repository: OpenRepository, targets: Sequence[str] = ()) -> StageGraph:
    """Collect the targets and everything upstream of them.

    ``repository``: targets are relative to its root. ``targets``: stage addresses (``modal@mug``), stage
    names (``modal``), object keys (``mug``) or paths of outputs, tried in that order; none means every stage
    of the workspace's ``dvc.yaml``. Neither none nor an object key includes stages in
    ``ON_DEMAND`` of `objectfolder.workspace.stages`, unless others that are included depend on them. Raises
    ObjectFolderError if there is no ``dvc.yaml``, or a target names nothing.
    """
    repo, root = repository.repo, repository.root
    if not (root / "dvc.yaml").is_file():
        raise ObjectFolderError(
            f"{root} has no dvc.yaml; run this in the workspace, the directory that holds dvc.yaml"
        )
    graph = get_active_graph(repo.index.graph)  # edges go from a stage to what it depends on
    addresses = {address_of(stage, root): stage for stage in graph}
    if targets:
        wanted = set().union(*(_match(target, addresses, root) for target in targets))
    else:
        own = {name for name, stage in addresses.items() if Path(stage.path) == root / "dvc.yaml"}
        wanted = _without_on_demand(own)
    names = {stage: address for address, stage in addresses.items()}
    named = nx.relabel_nodes(graph, names)
    named = named.subgraph(wanted.union(*(nx.descendants(named, address) for address in wanted)))
    order = list(nx.lexicographical_topological_sort(named.reverse()))
    return StageGraph(
        stages={address: addresses[address] for address in order},
        upstream={address: set(named.successors(address)) for address in order},
    )


def address_of(stage: Stage, root: Path) -> str:
    """Return the address of a stage relative to the workspace; DVC's is relative to the current directory."""
    path = os.path.relpath(stage.path, root)
    if not isinstance(stage, PipelineStage):
        return path
    return str(stage.name) if path == "dvc.yaml" else f"{path}:{stage.name}"


def all_stages(repository: OpenRepository) -> dict[str, Stage]:
    """Return all stages of a repository by address."""
    return {address_of(stage, repository.root): stage for stage in repository.repo.index.stages}


def dvc_files(repository: OpenRepository) -> list[Path]:
    """Return the files that record the state of stages: ``.dvc`` and lock files, sorted."""
    paths = {Path(stage.path) for stage in repository.repo.index.stages}
    return sorted(path if path.suffix == ".dvc" else path.with_suffix(".lock") for path in paths)


def _match(target: str, addresses: dict[str, Stage], root: Path) -> set[str]:
    if target in addresses:
        return {target}
    by_stage = {address for address in addresses if address.partition("@")[0] == target}
    if by_stage:
        return by_stage
    by_object = {address for address in addresses if address.partition("@")[2] == target}
    if target and by_object:
        return _without_on_demand(by_object)
    path = Path(os.path.normpath(root / target))
    by_output = {
        address
        for address, stage in addresses.items()
        for out in stage.outs
        if Path(out.fs_path) in (path, *path.parents)
    }
    if by_output:
        return by_output
    raise ObjectFolderError(
        f"unknown target {target!r}: expected a stage address, a stage name, an object key or the path of an "
        f"output; {_suggest(target, addresses, root)}"
    )


def _without_on_demand(addresses: set[str]) -> set[str]:
    return {address for address in addresses if address.partition("@")[0] not in ON_DEMAND}


def _suggest(target: str, addresses: dict[str, Stage], root: Path) -> str:
    outputs = (os.path.relpath(out.fs_path, root) for stage in addresses.values() for out in stage.outs)
    parts = (part for address in addresses for part in (address, *address.split("@")))
    close = difflib.get_close_matches(target, sorted({*parts, *outputs}), n=5)
    if close:
        return f"did you mean {', '.join(close)}?"
    split = (address.partition("@") for address in addresses)
    keys = ", ".join(sorted({key for stage, _, key in split if key and stage not in TASKS}))
    objects = f"the objects are {shortened(keys, 300)}" if keys else NO_OBJECTS
    return f"{objects}; `dvc stage list` lists the stages"
