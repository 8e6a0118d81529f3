"""Export presses and strikes of objects as a dataset of LeRobot, format v3.0: arrays per frame of episodes.

An episode is one contact at a random point: the object is struck there as the sensor arrives, and the sensor
is pressed in and drawn back. Each frame has a window of the sound, which begins with it, and a tactile image.
"""

import io
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from objectfolder.base.checks import finite_number, whole_number
from objectfolder.base.disk import new_folder
from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.io import write_json
from objectfolder.base.pictures import png_bytes
from objectfolder.base.seeding import numpy_generator
from objectfolder.objectfile.file import ObjectFile
from objectfolder.objectfile.query_files import sample_strikes

VERSION = "v3.0"  #: of the format
TOUCH, AUDIO, STATE, ACTION = "observation.images.touch", "observation.audio", "observation.state", "action"
#: Entries of the state, in metres and newtons; the action is the depth of the next frame.
STATES = ("point_x", "point_y", "point_z", "normal_x", "normal_y", "normal_z", "depth", "force")
IMPULSE = 0.01  #: N s
#: Statistics of a feature that are quantiles, by the names of the format.
QUANTILES = {"min": 0.0, "q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99, "max": 1.0}
_PATH = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
_EPISODES = "meta/episodes/chunk-000/file-000.parquet"

Report = Callable[[int, int], None]


def write_lerobot(
    files: Sequence[ObjectFile],
    out: str | Path,
    episodes: int = 10,
    seconds: float = 1.0,
    fps: int = 25,
    sample_rate: int = 16000,
    seed: int = 0,
    report: Report = lambda done, total: None,
) -> None:
    """Write a folder for ``LeRobotDataset("objectfolder/touch", root=OUT)``.

    Frames are in Parquet, tactile images as PNG in it; ``meta`` holds features, tasks, episodes and
    statistics, of the whole and of each episode. Sounds are displacement responses at absolute scale, as
    `ObjectFile.impact` gives them.

    Each file is a task of so many episodes, which have a length in seconds and so many frames per second, a
    divisor of the sample rate (Hz) of the sound. ``report`` is called with the numbers of written and of all
    episodes. Raises ObjectFolderError if the folder exists, a number is not valid, sensors differ in size, a
    touch net is not geometric, or two objects have one key.
    """
    import pandas as pd

    episodes, fps = whole_number("episodes", episodes, 1), whole_number("fps", fps, 1)
    rate = whole_number("sample rate", sample_rate, 1)
    frames = round(finite_number("seconds", seconds) * fps)
    if rate % fps:
        raise ObjectFolderError(
            f"fps is {fps}, expected a divisor of the sample rate, {rate} Hz, for equal windows, such as "
            f"{next((n for n in range(fps, rate) if rate % n == 0), rate)}"
        )
    if frames < 2:
        raise ObjectFolderError(f"seconds is {seconds:g}, expected at least 2 frames, {2 / fps:g}")
    sizes = {(file.sensor_profile.height, file.sensor_profile.width) for file in files}
    if len(sizes) != 1:
        raise ObjectFolderError(f"expected sensors with the same image size, got {sorted(sizes)}")
    for file in files:
        if (kind := file.header["touch"]["kind"]) != "geometric":
            raise ObjectFolderError(
                f"{file.key}: its touch net is of kind {kind!r}, expected 'geometric', which answers from "
                "the first contact on, with forces; build the object with train_touch.net: geometric"
            )
    keys = [file.key for file in files]
    if len(set(keys)) < len(keys):
        raise ObjectFolderError(f"expected objects with different keys, as each is a task; got {keys}")
    features = _features(*sizes.pop(), rate // fps, fps)
    total = episodes * len(files)
    rows: list[dict[str, Any]] = []
    task_of: list[int] = []
    with new_folder("export", Path(out), total * frames * 4 * rate // fps, ", or export fewer") as folder:
        for task, file in enumerate(files):
            rng = numpy_generator(seed, file.key, "lerobot")
            for episode in _episodes(file, episodes, frames, fps, rate, rng):
                number = len(task_of)
                for k, frame in enumerate(episode):
                    frame |= {"timestamp": k / fps, "frame_index": k, "episode_index": number}
                    rows.append(frame | {"index": len(rows), "task_index": task})
                task_of.append(task)
                report(number + 1, total)
        _write_frames(folder / _PATH.format(chunk_index=0, file_index=0), rows, features)
        tasks = [f"press and hear {file.key}" for file in files]
        (folder / "meta/episodes/chunk-000").mkdir(parents=True)
        index = pd.Index(tasks, name="task")
        pd.DataFrame({"task_index": range(len(tasks))}, index=index).to_parquet(folder / "meta/tasks.parquet")
        columns = _columns(rows)
        described = [
            _episode_row(number, tasks[task], frames, columns) for number, task in enumerate(task_of)
        ]
        pd.DataFrame(described).to_parquet(folder / _EPISODES)
        write_json(folder / "meta/stats.json", _statistics(columns))
        write_json(folder / "meta/info.json", _info(features, len(files), total, len(rows), fps))


def _episodes(
    file: ObjectFile, count: int, frames: int, fps: int, rate: int, rng: np.random.Generator
) -> Iterator[list[dict[str, Any]]]:
    """Yield the frames of each episode, without their numbers."""
    strikes = sample_strikes(file, count, int(rng.integers(2**31)), IMPULSE)
    points = strikes[:, :3]
    normals = file.contact_normals(points)  # the sensor's direction; strikes have that of the surface
    low, high = file.press_range()
    deepest = rng.uniform(low, high, count)
    ramp = np.sin(np.pi * np.arange(frames) / (frames - 1)) ** 2
    window = rate // fps
    sounds = file.impact(points, strikes[:, 3:], rate, frames / fps).astype(np.float32)
    for point, normal, depth, sound in zip(points, normals, deepest, sounds):
        depths = depth * ramp
        felt = file.press(np.repeat(point[None], frames, 0), depths)
        state = np.column_stack(
            [np.tile([*point, *normal], (frames, 1)), depths, np.nan_to_num(felt.force)]
        ).astype(np.float32)
        yield [
            {
                TOUCH: {"bytes": png_bytes(felt.images[k]), "path": None},
                AUDIO: sound[k * window : (k + 1) * window],
                STATE: state[k],
                ACTION: float(depths[min(k + 1, frames - 1)]),
            }
            for k in range(frames)
        ]


def _features(height: int, width: int, window: int, fps: int) -> dict[str, Any]:
    """Return the entry ``features`` of ``info.json``."""
    scalars = {"timestamp": "float32", "frame_index": "int64", "episode_index": "int64"}
    scalars |= {"index": "int64", "task_index": "int64"}
    return {
        TOUCH: {"dtype": "image", "shape": [height, width, 3], "names": ["height", "width", "channels"]},
        AUDIO: {"dtype": "float32", "shape": [window], "names": None},
        STATE: {"dtype": "float32", "shape": [len(STATES)], "names": list(STATES)},
        ACTION: {"dtype": "float32", "shape": [1], "names": ["depth"]},
    } | {name: {"dtype": kind, "shape": [1], "names": None} for name, kind in scalars.items()}


def _write_frames(path: Path, rows: list[dict[str, Any]], features: dict[str, Any]) -> None:
    import datasets
    import pyarrow as pa
    from pyarrow.parquet import write_table

    columns: dict[str, Any] = {}
    for name, feature in features.items():
        value = datasets.Value(feature["dtype"]) if feature["dtype"] != "image" else datasets.Image()
        scalar = feature["shape"] == [1] or feature["dtype"] == "image"  # of a single number, no list
        columns[name] = value if scalar else datasets.List(value, length=feature["shape"][0])
    schema = datasets.Features(columns).arrow_schema
    path.parent.mkdir(parents=True)
    write_table(pa.Table.from_pylist(rows, schema=schema), path)


def _episode_row(number: int, task: str, frames: int, columns: dict[str, np.ndarray]) -> dict[str, Any]:
    """Return the entry of an episode in ``meta/episodes``; the statistics, too, are of its frames."""
    start, end = number * frames, (number + 1) * frames
    found = _statistics({name: values[start:end] for name, values in columns.items()})
    return {
        **{"episode_index": number, "tasks": [task], "length": frames},
        **{"data/chunk_index": 0, "data/file_index": 0, "dataset_from_index": start, "dataset_to_index": end},
        **{"meta/episodes/chunk_index": 0, "meta/episodes/file_index": 0},
    } | {f"stats/{name}/{key}": value for name, one in found.items() for key, value in one.items()}


def _columns(rows: list[dict[str, Any]]) -> dict[str, np.ndarray]:
    """Return the values of each feature as (frames, length), but of images how often colours have each level.

    These are (frames, 256, 3) numbers of pixels: less memory than the images, and the same statistics.
    """
    columns = {}
    for name in rows[0]:
        if name == TOUCH:
            columns[name] = np.stack([_levels(row[name]["bytes"]) for row in rows])
        else:
            columns[name] = np.stack([np.atleast_1d(row[name]) for row in rows]).astype(np.float64)
    return columns


def _levels(png: bytes) -> np.ndarray:
    """Return the number of pixels with each level of each colour, (256, 3)."""
    pixels = np.asarray(Image.open(io.BytesIO(png))).reshape(-1, 3)
    return np.stack([np.bincount(color, minlength=256) for color in pixels.T], 1).astype(np.int32)


def _statistics(columns: dict[str, np.ndarray]) -> dict[str, dict[str, list[Any]]]:
    """Return quantiles, mean and deviation of each feature; of images by colour, in [0, 1]."""
    found = {}
    for name, values in columns.items():
        count, weights = [len(values)], None
        if name == TOUCH:
            weights = values.sum(0, dtype=np.int64)
            values = np.broadcast_to(np.linspace(0, 1, 256)[:, None], weights.shape)
        mean = np.average(values, 0, weights)
        quantiles = np.quantile(values, [*QUANTILES.values()], 0, weights=weights, method="inverted_cdf")
        moments = dict(zip(QUANTILES, quantiles))
        moments |= {"mean": mean, "std": np.sqrt(np.average((values - mean) ** 2, 0, weights))}
        if name == TOUCH:
            moments = {key: value[:, None, None] for key, value in moments.items()}
        found[name] = {key: value.tolist() for key, value in moments.items()} | {"count": count}
    return found


def _info(features: dict[str, Any], tasks: int, episodes: int, frames: int, fps: int) -> dict[str, Any]:
    sizes = {"chunks_size": 1000, "data_files_size_in_mb": 100, "video_files_size_in_mb": 200}
    return {
        **{"codebase_version": VERSION, "robot_type": None, "features": features, "fps": fps, **sizes},
        **{"total_episodes": episodes, "total_frames": frames, "total_tasks": tasks},
        **{"splits": {"train": f"0:{episodes}"}, "data_path": _PATH, "video_path": None},
    }
