"""Fuzz the reader of Object Files: `python fuzz/objectfile.py [-max_total_time=600]` (needs atheris).

Damages a small Object File: random bytes, or values of its header and tensors in an otherwise valid
safetensors file. Loads the result and queries it. The query must return finite numbers or raise an
ObjectFolderError. Anything else, more than 20 seconds or more than 8 GiB stops the run and saves the input.
(Each opened file leaks a third of a megabyte under atheris, but not without it.)
"""

import json
import logging
import struct
import sys
import tempfile
from contextlib import suppress
from pathlib import Path

import atheris

sys.path[:0] = [str(Path(__file__).parents[1]), str(Path(__file__).parents[1] / "tests" / "support")]
with atheris.instrument_imports(include=["objectfolder"]):
    import numpy as np
    import torch
    from brick import build_brick
    from damage import leaves

    from objectfolder.base.errors import ObjectFolderError
    from objectfolder.objectfile.file import ObjectFile
    from objectfolder.vision import radiosity

ODD_VALUES = (
    *(0, -1, 1, 2, 0.5, 1000, 1e308, 1e-300, -1e-308, 2**31, 2**63),
    *(True, None, "", "x", "../..", [], {}, [[]], "none"),
)
FOLDER = Path(tempfile.mkdtemp(prefix="fuzz"))


def damaged(data: atheris.FuzzedDataProvider, whole: bytes) -> bytes:
    """Return a damaged copy of a file."""
    length = struct.unpack("<Q", whole[:8])[0]
    outer, body = json.loads(whole[8 : 8 + length]), bytearray(whole[8 + length :])
    kind = data.ConsumeIntInRange(0, 4)
    if kind == 0:  # random bytes
        raw = bytearray(whole)
        for _ in range(data.ConsumeIntInRange(1, 8)):
            raw[data.ConsumeIntInRange(0, len(raw) - 1)] = data.ConsumeIntInRange(0, 255)
        return bytes(raw[: data.ConsumeIntInRange(0, len(raw))] if data.ConsumeBool() else raw)
    if kind == 1:  # no valid file at all
        return data.ConsumeBytes(4096)
    header = json.loads(outer["__metadata__"]["objectfolder"])
    if kind in (2, 4):
        for _ in range(data.ConsumeIntInRange(1, 3)):
            container, key = data.PickValueInList(leaves(header))
            if data.ConsumeBool() and isinstance(container, dict):
                container.pop(key, None)
            else:
                values = [*ODD_VALUES, data.ConsumeFloat(), data.ConsumeInt(4)]
                container[key] = data.PickValueInList(values)
    if kind in (3, 4):
        name = data.PickValueInList(sorted(outer.keys() - {"__metadata__"}))
        start, end = outer[name]["data_offsets"]
        how = data.ConsumeIntInRange(0, 3)
        if how == 0:
            for _ in range(data.ConsumeIntInRange(1, 8)):
                body[data.ConsumeIntInRange(start, max(start, end - 1))] = data.ConsumeIntInRange(0, 255)
        elif how == 1:
            outer[name]["shape"] = [
                data.ConsumeIntInRange(0, 70) for _ in range(data.ConsumeIntInRange(0, 4))
            ]
        elif how == 2:
            outer[name]["dtype"] = data.PickValueInList(
                ["F64", "F16", "BF16", "I64", "U8", "BOOL", "F8_E4M3"]
            )
        else:
            outer[data.PickValueInList(["x", "audio.x", "geometry.distances"])] = outer.pop(name)
    outer["__metadata__"]["objectfolder"] = json.dumps(header)
    text = json.dumps(outer).encode()
    return struct.pack("<Q", len(text)) + text + bytes(body)


def query(file: ObjectFile, which: int) -> None:
    """Run one of the queries."""
    up, place = [[0.0, 0.0, 1.0]], [[0.0, 0.0, 0.015]]
    queries = (
        lambda: file.impact(place, up, duration=0.01),
        lambda: file.impact(place, up, duration=0.01, material="steel", scale=0.05),
        lambda: file.touch(place, 0.0005),
        lambda: file.view([[1.5, 1.0, 1.0]], [[0.5, 0.5, 0.9]], 8),
        lambda: file.nearest(place)[0],
        file.check,
    )
    answer = queries[which % len(queries)]()
    if answer is not None and not np.isfinite(answer).all():
        raise AssertionError("the answer is not finite")


def main() -> None:
    """Build the file and fuzz it."""
    torch.set_num_threads(1)
    logging.disable()
    radiosity.PATCHES = 64  # radiosity dominates the time of a small view
    path = FOLDER / "file.safetensors"
    build_brick(steps=2).save(path)
    whole = path.read_bytes()

    def once(raw: bytes) -> None:
        data = atheris.FuzzedDataProvider(raw)
        which = data.ConsumeIntInRange(0, 255)
        path.write_bytes(damaged(data, whole))
        with suppress(ObjectFolderError):
            query(ObjectFile.load(path), which)

    options = ["-timeout=20", "-rss_limit_mb=8192", "-len_control=0", "-max_len=256"]
    atheris.Setup([sys.argv[0], *options, f"-artifact_prefix={FOLDER}/", *sys.argv[1:]], once)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
