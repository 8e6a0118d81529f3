"""Export observations as WebDataset shards or as a folder for Hugging Face ``datasets``.

Views and touches are PNG, sounds float WAV at absolute scale. The same observations give the same bytes.
"""

import json
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np

from objectfolder.base.arrays import wav_bytes
from objectfolder.base.disk import new_folder
from objectfolder.base.errors import ObjectFolderError, plural
from objectfolder.base.io import write_json, write_text
from objectfolder.base.pictures import png_bytes
from objectfolder.base.seeding import numpy_generator
from objectfolder.benchmarks.datasets.observations import Observations
from objectfolder.benchmarks.datasets.splits import Split
from objectfolder.stored.header import checked_name
from objectfolder.workspace.layout import MODALITIES, SPLITS

_BATCH = 50  # rows in the memory at once, and in a row group of Parquet, which viewers read whole
_HUB_SPLITS = {"train": "train", "val": "validation", "test": "test"}  # as the library names them

Report = Callable[[int, int], None]


def write_webdataset(
    observations: Observations,
    split: Split,
    out: str | Path,
    shard: int = 1000,
    report: Report = lambda done, total: None,
) -> None:
    """Write tar files for ``webdataset``.

    A sample has ``vision.png``, ``audio.wav``, ``touch.png`` and ``json``: label, key, material, scale and
    queries (`objectfolder.benchmarks.datasets.sampling.draw_queries`). Samples are shuffled, because readers
    stream them; ``index.json`` holds the label names and the number of samples of each shard.

    Creates a folder of ``train-000000.tar`` ... ``val-000000.tar`` ... ``test-000000.tar`` ... with so many
    samples per shard. ``report`` is called with the numbers of written and of all samples.

    Raises ObjectFolderError if the folder exists, or the disk is full.
    """
    from webdataset import TarWriter

    if shard < 1:
        raise ObjectFolderError(f"shards of {shard} samples, expected a positive number")
    total, done = _total(split), 0
    shards: dict[str, list[dict[str, Any]]] = {}
    with _new_folder(Path(out), observations, total) as folder:
        for name in SPLITS:
            rows = numpy_generator(0, "export", split.name, name).permutation(getattr(split, name))
            parts = [rows[start : start + shard] for start in range(0, len(rows), shard)]
            files = [f"{name}-{i:06d}.tar" for i in range(len(parts))]
            shards[name] = [{"file": file, "samples": len(part)} for file, part in zip(files, parts)]
            for file, part in zip(files, parts):
                with (folder / file).open("wb") as stream:
                    owner = {"user": "objectfolder", "group": "objectfolder", "mtime": 0}
                    with TarWriter(stream, encoder=False, **owner) as tar:
                        for sample in _samples(observations, part):
                            tar.write(_members(sample))
                            done += 1
                            report(done, total)
        index = {"split": split.name, "labels": list(observations.keys), "shards": shards}
        write_json(folder / "index.json", index)


def write_datasets(
    observations: Observations, split: Split, out: str | Path, report: Report = lambda done, total: None
) -> None:
    """Write a folder for ``datasets.load_dataset(OUT)``: Parquet files and a card.

    For the rest see `write_webdataset`. Raises ObjectFolderError if the folder exists, or the disk is full.
    """
    import datasets
    import pyarrow as pa
    from pyarrow.parquet import ParquetWriter

    vector = datasets.List(datasets.Value("float64"), length=3)
    features = datasets.Features(
        {
            "vision": datasets.Image(),
            "audio": datasets.Audio(sampling_rate=_rate(observations), decode=False),
            "touch": datasets.Image(),
            "label": datasets.ClassLabel(names=list(observations.keys)),
            "observation": datasets.Value("int32"),
            "material": datasets.Value("string"),
            "scale": datasets.Value("float64"),
            "sensor": datasets.Value("string"),
        }
        | {
            name: vector if values.ndim == 2 else datasets.Value("float64")
            for name, values in observations.queries(observations.keys[0]).items()
        }
    )
    schema = features.arrow_schema
    total, done = _total(split), 0
    with _new_folder(Path(out), observations, total) as folder:
        (folder / "data").mkdir()
        for name, known in _HUB_SPLITS.items():
            rows = getattr(split, name)
            with ParquetWriter(folder / "data" / f"{known}-00000-of-00001.parquet", schema) as parquet:
                for start in range(0, len(rows), _BATCH):
                    samples = [
                        _columns(sample) for sample in _samples(observations, rows[start : start + _BATCH])
                    ]
                    parquet.write_table(pa.Table.from_pylist(samples, schema=schema))
                    done += len(samples)
                    report(done, total)
        write_text(folder / "README.md", _card(observations, split))


def _samples(observations: Observations, rows: np.ndarray) -> Iterator[dict[str, Any]]:
    """Yield encoded rows, reading few at a time."""
    queries = {key: observations.queries(key) for key in observations.keys}
    for start in range(0, len(rows), _BATCH):
        batch = rows[start : start + _BATCH]
        arrays = {modality: observations.read(modality, batch) for modality in MODALITIES}
        for i, row in enumerate(batch.tolist()):
            label, number = divmod(row, observations.count)
            key = observations.keys[label]
            record = observations.records[key]
            yield {
                "vision": png_bytes(arrays["vision"][i]),
                "audio": wav_bytes(arrays["audio"][i], record["sample_rate"]),
                "touch": png_bytes(arrays["touch"][i]),
                "label": label,
                "key": key,
                "observation": number,
                **{name: record[name] for name in ("material", "scale", "sensor")},
                "queries": {name: values[number].tolist() for name, values in queries[key].items()},
            }


def _members(sample: dict[str, Any]) -> dict[str, Any]:
    """Return the files of a WebDataset sample."""
    said = {name: value for name, value in sample.items() if name not in MODALITIES}
    return {
        "__key__": f"{sample['key']}_{sample['observation']:06d}",
        "vision.png": sample["vision"],
        "audio.wav": sample["audio"],
        "touch.png": sample["touch"],
        "json": json.dumps(said, sort_keys=True).encode(),
    }


def _columns(sample: dict[str, Any]) -> dict[str, Any]:
    """Return the columns of a ``datasets`` sample."""
    name, suffixes = f"{sample['key']}_{sample['observation']:06d}", {"audio": "wav"}
    stored = {
        modality: {"bytes": sample[modality], "path": f"{name}_{modality}.{suffixes.get(modality, 'png')}"}
        for modality in MODALITIES
    }
    return {**sample, **stored, **sample["queries"]}


def _rate(observations: Observations) -> int:
    return int(observations.records[observations.keys[0]]["sample_rate"])


def _total(split: Split) -> int:
    return sum(len(getattr(split, name)) for name in SPLITS)


def _new_folder(out: Path, observations: Observations, samples: int) -> AbstractContextManager[Path]:
    for key in observations.keys:
        checked_name("key", key, "key of observations")  # names files, and stands in the card
    # Size of the sounds; that of the compressed images is not known before.
    needed = samples * 4 * observations.shape("audio")[0]
    return new_folder("export", out, needed, ", or export fewer objects")


def _card(observations: Observations, split: Split) -> str:
    """README.md of a folder for ``datasets``: where it looks for files, and for people."""
    files = "".join(f"  - {{split: {name}, path: data/{name}-*.parquet}}\n" for name in _HUB_SPLITS.values())
    side, (height, width, _) = observations.shape("vision")[0], observations.shape("touch")
    seconds = observations.shape("audio")[0] / _rate(observations)
    names = ", ".join(observations.keys)
    return f"""\
---
configs:
- config_name: default
  data_files:
{files}---

# Views, impact sounds and touches of {plural(len(observations.keys), "object")}

{observations.count} of each per object, drawn from their Object Files. Split `{split.name}`:
{len(split.train)} rows to train, {len(split.val)} to validate, {len(split.test)} to test.

- `vision`: {side} x {side} sRGB on white; `vision_camera`, `vision_light`: where they were, in the frame in
  which the object's longest side is 1.
- `audio`: {seconds:g} s at {_rate(observations)} Hz, float WAV at absolute, tiny scale; `audio_point`:
  metres; `audio_force`: impulse, N s.
- `touch`: {height} x {width}, of the sensor in `sensor`; `touch_point`: metres; `touch_depth`: of the press,
  metres.
- `label`: the object; `observation`: its number; `material`; `scale`: longest side, metres.

Objects: {names}.
"""
