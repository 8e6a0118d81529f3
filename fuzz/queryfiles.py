"""Fuzz the reader of query files: `python fuzz/queryfiles.py [-max_total_time=600]` (needs atheris).

Reads random bytes and .npy files with random headers as rows. Reading must return finite float64 of the
right shape or raise an ObjectFolderError. Anything else stops the run and saves the input.
"""

import struct
import sys
import tempfile
import warnings
from pathlib import Path

import atheris

sys.path.insert(0, str(Path(__file__).parents[1]))
with atheris.instrument_imports(include=["objectfolder"]):
    import numpy as np

    from objectfolder.base.arrays import read_rows
    from objectfolder.base.errors import ObjectFolderError
    from objectfolder.stored.arguments import finite_rows

FOLDER = Path(tempfile.mkdtemp(prefix="fuzz"))
DTYPES = (
    "<f8",
    ">f4",
    "<f2",
    "|i1",
    "<u8",
    "|b1",
    "<c16",
    "|O",
    "<U4",
    "|V8",
    "<M8[s]",
    "[('a', '<f8')]",
    "",
)
TEXT = "{'descr': %s, 'fortran_order': %s, 'shape': %s, }"


def query_file(data: atheris.FuzzedDataProvider) -> bytes:
    """Return random bytes or a file that resembles a query file."""
    kind = data.ConsumeIntInRange(0, 3)
    if kind == 0:
        return data.ConsumeBytes(512)
    dtype = data.PickValueInList(list(DTYPES))
    shape = tuple(data.ConsumeInt(data.ConsumeIntInRange(1, 8)) for _ in range(data.ConsumeIntInRange(0, 3)))
    if kind == 1:
        shape = (data.ConsumeIntInRange(0, 4), 3)
    text = TEXT % (repr(dtype), data.ConsumeBool(), shape)
    if kind == 2:
        place = data.ConsumeIntInRange(0, len(text))
        text = text[:place] + data.ConsumeUnicodeNoSurrogates(20) + text[place:]
    raw = text.encode()
    version = data.ConsumeIntInRange(0, 3)
    size = struct.pack("<H" if version == 1 else "<I", len(raw))
    return b"\x93NUMPY" + bytes([version, 0]) + size + raw + data.ConsumeBytes(256)


def once(raw: bytes) -> None:
    """Read one file."""
    path = FOLDER / "queries.npy"
    path.write_bytes(query_file(atheris.FuzzedDataProvider(raw)))
    try:
        found = finite_rows("queries", read_rows(path, 3), 3)
    except ObjectFolderError:
        return
    if found.dtype != np.float64 or found.shape[1] != 3 or not np.isfinite(found).all():
        raise AssertionError(f"invalid rows were accepted: {found!r}")


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    options = ["-timeout=5", "-rss_limit_mb=1024", "-len_control=0", "-max_len=512"]
    atheris.Setup([sys.argv[0], *options, f"-artifact_prefix={FOLDER}/", *sys.argv[1:]], once)
    atheris.Fuzz()
