"""Fuzz the reader of released files: `python fuzz/released.py [-max_total_time=600]` (needs atheris).

Damages small files like those of ObjectFolder 1.0 and 2.0, in both formats of torch: random bytes, bytes of
the pickle, or a truncated end. The importer must convert the file or raise an ObjectFolderError. Anything
else, more than 20 seconds or more than 8 GiB stops the run and saves the input.
"""

import io
import logging
import sys
import tempfile
import zipfile
from contextlib import suppress
from pathlib import Path

import atheris

sys.path[:0] = [str(Path(__file__).parents[1]), str(Path(__file__).parents[1] / "tests" / "support")]
with atheris.instrument_imports(include=["objectfolder"]):
    import numpy as np
    import released_files
    import torch

    from objectfolder.base.errors import ObjectFolderError
    from objectfolder.hub.importer.convert import ImportOptions, convert

FOLDER = Path(tempfile.mkdtemp(prefix="fuzz"))
PICKLE = 2000  # leading bytes of the older format, which hold its structure


def whole_files() -> list[bytes]:
    """Return files of both releases in both formats."""
    files = []
    for make in (released_files.released_1, released_files.released_2):
        for zipped in (True, False):
            stream = io.BytesIO()
            torch.save(make(width=2), stream, _use_new_zipfile_serialization=zipped)
            files.append(stream.getvalue())
    return files


def scattered(data: atheris.FuzzedDataProvider, raw: bytes, most: int) -> bytes:
    """Change some of the first bytes."""
    changed = bytearray(raw)
    for _ in range(data.ConsumeIntInRange(1, 6)):
        changed[data.ConsumeIntInRange(0, min(most, len(raw)) - 1)] = data.ConsumeIntInRange(0, 255)
    return bytes(changed)


def damaged(data: atheris.FuzzedDataProvider, raw: bytes) -> bytes:
    """Return a damaged copy of a file."""
    kind = data.ConsumeIntInRange(0, 3)
    if kind == 0:
        return raw[: data.ConsumeIntInRange(0, len(raw))]
    if kind == 1:
        return scattered(data, raw, len(raw))
    if not zipfile.is_zipfile(io.BytesIO(raw)):
        return scattered(data, raw, PICKLE)
    # Write a new archive, so that the checksums are valid.
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(raw)) as source, zipfile.ZipFile(out, "w") as target:
        for entry in source.infolist():
            content = source.read(entry)
            if entry.filename.endswith("data.pkl"):
                content = scattered(data, content, len(content))
            target.writestr(entry.filename, content)
    return out.getvalue()


def main() -> None:
    """Make the files and fuzz them."""
    torch.set_num_threads(1)
    logging.disable()
    files, path = whole_files(), FOLDER / "ObjectFile.pth"
    options = ImportOptions(key="fuzzed", bounds=np.array([[-0.5] * 3, [0.5] * 3]))

    def once(raw: bytes) -> None:
        data = atheris.FuzzedDataProvider(raw)
        path.write_bytes(damaged(data, data.PickValueInList(files)))
        with suppress(ObjectFolderError):
            convert(path, options)

    limits = ["-timeout=20", "-rss_limit_mb=8192", "-len_control=0", "-max_len=256"]
    atheris.Setup([sys.argv[0], *limits, f"-artifact_prefix={FOLDER}/", *sys.argv[1:]], once)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
