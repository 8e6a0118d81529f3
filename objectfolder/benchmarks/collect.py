"""Collect the samples of benchmarks from Object Files, several objects at a time."""

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import torch

from objectfolder.benchmarks.datasets import grasps, observations
from objectfolder.benchmarks.datasets.glances import glance_request, is_glanced, sample_glances
from objectfolder.benchmarks.datasets.observe_config import ObserveConfig
from objectfolder.benchmarks.datasets.sampling import is_sampled, observation_request, sample_observations
from objectfolder.benchmarks.tasks.running import Report
from objectfolder.engine.process import in_processes
from objectfolder.errors import ObjectFolderError
from objectfolder.objectfile.dataset import INDEX, Dataset
from objectfolder.objectfile.file import ObjectFile
from objectfolder.workspace.layout import Benchmarks, Build

if TYPE_CHECKING:
    from objectfolder.benchmarks.datasets.grasp_config import GraspDataConfig

#: Wraps an iteration in a progress bar, given its description and length.
Tracker = Callable[[Iterable[Any], str, int], Iterable[Any]]


class LoadedFile(NamedTuple):
    """An Object File and its path."""

    path: Path
    file: ObjectFile


def load_object_files(places: Sequence[Path] | None) -> dict[str, LoadedFile]:
    """Load Object Files; return them by key.

    Parameters
    ----------
    places : sequence of Path, optional
        Object Files, folders that contain some, or releases. Default: ``build``.

    Raises
    ------
    ObjectFolderError
        If a place has none, one is invalid, or two are of the same object.
    """
    sources: dict[str, LoadedFile] = {}
    for path, file in (found for place in places or [Build("any").dir.parent] for found in _files_in(place)):
        if file.key in sources:
            raise ObjectFolderError(
                f"{path} and {sources[file.key].path} are both of {file.key}; give each object once"
            )
        sources[file.key] = LoadedFile(path, file)
    return sources


def _files_in(place: Path) -> Iterator[tuple[Path, ObjectFile]]:
    if (place / INDEX).is_file():
        dataset = Dataset(place)
        yield from zip(map(dataset.path, dataset.keys), dataset)
        return
    if place.is_file():
        yield place, ObjectFile.load(place)
        return
    name = Build("any").object_file.name
    # Skip the copies in folders of observations, which queries are written to first.
    found = [path for path in sorted(place.rglob(name)) if not (path.parent / observations.QUERIES).exists()]
    if not found:
        raise ObjectFolderError(
            f"no Object Files in {place}: no {name} in it or below; run `objectfolder build`, or name others"
        )
    yield from ((path, ObjectFile.load(path)) for path in found)


def collect_observations(
    sources: Mapping[str, LoadedFile],
    wanted: ObserveConfig,
    seed: int,
    folder: Benchmarks,
    jobs: int,
    track: Tracker,
) -> dict[str, Path]:
    """Sample observations of each object, unless its folder is complete; return the folders by key."""
    settings = (wanted.observations, wanted.resolution, seed)
    folders = {key: folder.observations(key) for key in sources}
    new = []
    for key, source in sources.items():
        if (folders[key] / observations.RECORD).is_file() and is_sampled(
            observation_request(source.file, *settings), folders[key]
        ):
            continue
        new.append((source.path, *settings, folders[key]))
    if new:  # starting processes takes seconds
        for _ in track(in_processes(_observe, new, jobs), "observing objects", len(new)):
            pass
    return folders


def _observe(path: Path, count: int, resolution: int, seed: int, folder: Path) -> None:
    torch.set_num_threads(1)
    sample_observations(ObjectFile.load(path), count, resolution, seed, folder)


def collect_glances(
    sources: Mapping[str, LoadedFile],
    count: int,
    size: tuple[int, int],
    seed: int,
    folder: Benchmarks,
    jobs: int,
    track: Tracker,
) -> dict[str, Path]:
    """See and press each object from close by, unless its folder is complete; return the folders by key."""
    folders = {key: folder.glances(key) for key in sources}
    requests = {key: glance_request(source.file, count, size, seed) for key, source in sources.items()}
    new = [
        (source.path, count, size, seed, folders[key])
        for key, source in sources.items()
        if not is_glanced(requests[key], folders[key])
    ]
    if new:
        for _ in track(in_processes(_glance, new, jobs), "looking and touching", len(new)):
            pass
    return folders


def _glance(path: Path, count: int, size: tuple[int, int], seed: int, folder: Path) -> None:
    torch.set_num_threads(1)
    sample_glances(ObjectFile.load(path), count, size, seed, folder)


def collect_all_grasps(
    sources: Mapping[str, LoadedFile],
    wanted: "GraspDataConfig",
    max_hulls: int,
    seed: int,
    folder: Benchmarks,
    jobs: int,
    track: Tracker,
    report: Report,
) -> dict[str, Path]:
    """Simulate grasps of each object, unless its folder is complete; return the folders by key.

    Touches are also simulated on the true surfaces if these lie beside all Object Files, and all touch nets
    answer the presses of pads.
    """
    from objectfolder.benchmarks.datasets.grasp_data import grasp_request, is_collected
    from objectfolder.envs.body import rigid_body
    from objectfolder.envs.hulls import cached_hulls
    from objectfolder.mesh.ply import read_surface

    folders = {key: folder.grasps(key) for key in sources}
    surfaces = {key: source.path.with_name(Build(key).surface.name) for key, source in sources.items()}
    lacking = [key for key, surface in surfaces.items() if not surface.is_file()]
    fixed = [key for key, source in sources.items() if source.file.fixed_contact]
    for keys, reason in (
        (lacking, "no true surface beside the Object File of"),
        (fixed, "a touch net of images, which knows one press alone, in"),
    ):
        if keys:
            report(
                f"{reason} {', '.join(keys)}: touches are simulated from Object Files only, "
                "without explicit ones to compare with"
            )
    new = []
    for key, source in sources.items():
        surface = None if lacking or fixed else surfaces[key]
        if (folders[key] / grasps.RECORD).is_file():  # and hence its hulls
            body = rigid_body(source.file, cached_hulls(source.file, folder.hulls, max_hulls))
            truth = None if surface is None else read_surface(surface)
            if is_collected(grasp_request(source.file, body, wanted, seed, truth), folders[key]):
                continue
        new.append((source.path, surface, wanted, max_hulls, seed, folder, report))
    if new:
        for _ in track(in_processes(_grasp, new, jobs), "grasping objects", len(new)):
            pass
    return folders


def _grasp(
    path: Path,
    surface: Path | None,
    wanted: "GraspDataConfig",
    max_hulls: int,
    seed: int,
    folder: Benchmarks,
    report: Report,
) -> None:
    from threadpoolctl import threadpool_limits

    from objectfolder.benchmarks.datasets.grasp_data import collect_grasps
    from objectfolder.envs.body import rigid_body
    from objectfolder.envs.hulls import cached_hulls
    from objectfolder.mesh.ply import read_surface

    torch.set_num_threads(1)
    with threadpool_limits(1):
        file = ObjectFile.load(path)
        body = rigid_body(file, cached_hulls(file, folder.hulls, max_hulls))
        truth = None if surface is None else read_surface(surface)
        start = time.perf_counter()
        collect_grasps(file, body, wanted, seed, folder.grasps(file.key), truth)
        seconds = time.perf_counter() - start
    report(f"{file.key}: {wanted.grasps} grasps in {seconds:.0f} s, {wanted.grasps / seconds:.1f} per second")
