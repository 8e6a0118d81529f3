"""Checks of the arguments of public functions, before any work is done."""

import math
import os
import re
from collections.abc import Sequence
from contextlib import suppress
from numbers import Integral, Real
from typing import Any

import numpy as np

from objectfolder.base.errors import ObjectFolderError, quoted
from objectfolder.base.text import visible

#: Why a query of tensors that torch has wrapped is refused.
TRANSFORMED = "torch.func and vmap are not supported; use torch.autograd.grad with ObjectFile.torch()"

DENSITIES = (1.0, 25_000.0)  #: least and greatest of a body, kg/m^3: lighter than foam, heavier than osmium

#: An address of the web without a user's name or password, of the characters that RFC 3986 allows.
_WEB_ADDRESS = re.compile(
    r"https?://(?:[A-Za-z0-9](?:[A-Za-z0-9.-]*[A-Za-z0-9])?|\[[0-9A-Fa-f:.]+\])(?::[0-9]{1,5})?"
    r"(?:[/?#][A-Za-z0-9._~:/?#\[\]@!$&'()*+,;=%-]*)?"
)


def finite_number(name: str, value: object) -> float:
    """Return a real, finite number; raises ObjectFolderError if it is anything else.

    Numpy's and torch's scalars are numbers, texts and truth values are not.
    """
    given = _scalar(value)
    if isinstance(given, Real) and not isinstance(given, bool):
        with suppress(OverflowError):
            if math.isfinite(number := float(given)):
                return number
    raise ObjectFolderError(f"{name} is {quoted(value)}, expected a finite number")


def check_mass(name: str, mass: float, volume: float, space: str = "its volume") -> None:
    """Raise ObjectFolderError if a body of this mass, kg, in this volume, m^3, is not in `DENSITIES`."""
    least, most = DENSITIES
    density = mass / volume
    if not least <= density <= most:
        grams = f": {mass / 1000:g} for {mass:g} g" if least <= density / 1000 <= most else ""
        raise ObjectFolderError(
            f"{name}: mass is {mass:g} kg, in {space} of {volume * 1e6:.4g} cm³ a density of {density:,.4g} "
            f"kg/m³, expected {least:g} to {most:,g}; give kilograms{grams}, or check the scale, in metres"
        )


def real_array(name: str, values: Any) -> np.ndarray:
    """Return real numbers as a new float64 array, without gradients.

    ``name``: for the message. Raises ObjectFolderError if they are not real numbers, not a rectangular array,
    or some are masked.
    """
    rows = values if isinstance(values, list | tuple) else [values]
    if any(isinstance(row, np.ma.MaskedArray) and np.ma.is_masked(row) for row in rows):
        raise ObjectFolderError(f"{name} holds masked values, expected numbers: leave them out or fill them")
    try:
        if hasattr(values, "detach"):  # a tensor, without importing torch
            if _is_transformed(values):
                raise ObjectFolderError(f"{name}: {TRANSFORMED}")
            values = values.detach().cpu()
            values = values.double() if values.is_floating_point() else values
        array = np.asarray(values)
        if array.dtype.kind not in "fiu" and array.size:
            raise ObjectFolderError(f"{name} holds {array.dtype}, expected real numbers")
        with np.errstate(over="ignore"):  # of a longer float: becomes infinite
            return array.astype(np.float64)
    except ObjectFolderError:
        raise
    except (ValueError, TypeError, RuntimeError, OverflowError) as error:
        if holds_tensors(values):
            raise ObjectFolderError(
                f"{name} is a list of tensors, expected one tensor or an array: torch.stack joins them. "
                "Queries carry no gradients: detach tensors that require them, or use ObjectFile.torch()"
            ) from error
        raise ObjectFolderError(f"{name} is not an array of numbers: {error}") from error


def refuse_rows(name: str, wrong: np.ndarray, values: np.ndarray, expected: str) -> None:
    """Raise ObjectFolderError about the first of N rows that is wrong, if any is.

    The message goes on after its value, one of numbers (N,) or rows (N, K), with ``expected``.
    """
    rows = np.flatnonzero(wrong)
    if len(rows):
        value = values[rows[0]]
        shown = value.tolist() if np.ndim(value) else f"{value:g}"
        raise ObjectFolderError(f"{name}: row {rows[0]} is {shown}{expected}")


def holds_tensors(values: object) -> bool:
    """Return whether they are a list, also of lists, that holds a tensor."""
    return isinstance(values, list | tuple) and any(
        hasattr(value, "detach") or holds_tensors(value) for value in values
    )


def whole_number(name: str, value: object, least: int = 0) -> int:
    """Return a whole number of an integer type; ObjectFolderError if below ``least``, or beyond 64 bits."""
    given = _scalar(value)
    if isinstance(given, Integral) and not isinstance(given, bool) and least <= int(given) < 2**63:
        return int(given)
    raise ObjectFolderError(f"{name} is {quoted(value)}, expected a whole number of at least {least}")


def one_of(name: str, value: object, choices: Sequence[str]) -> str:
    """Return a text that is one of a few; raises ObjectFolderError if it is another, or no text."""
    if isinstance(value, str) and value in choices:
        return value
    raise ObjectFolderError(f"{name} {quoted(value)} is not one of {', '.join(choices)}")


def is_web_address(text: str) -> bool:
    """Return whether it is an http or https address with a host, and nothing that hides where it leads."""
    return len(text) <= 2000 and _WEB_ADDRESS.fullmatch(text) is not None


def one_line(name: str, value: str, most: int = 200) -> str:
    """Return a line that people will read; ObjectFolderError if blank, longer, or with control characters."""
    if not value.strip() or len(value) > most or visible(value) != value:
        expected = f"a line of 1 to {most} characters without control characters"
        raise ObjectFolderError(f"{name} {quoted(value)}, expected {expected}")
    return value


def require_memory(what: str, needed: int, remedy: str) -> None:
    """Raise ObjectFolderError if work does not fit into the memory of this machine.

    ``what``: name of the work, for the message; ``needed``: bytes; ``remedy``: what to ask for instead.
    """
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    if needed > memory:
        raise ObjectFolderError(f"{what}: needs {needed:,} bytes, this machine has {memory:,}; {remedy}")


def _is_transformed(tensor: Any) -> bool:
    """Return whether torch.func or vmap has wrapped a tensor, whose values then cannot be read."""
    import torch  # it is there, as there is a tensor

    wrapped = getattr(torch._C._functorch, "is_functorch_wrapped_tensor", None)
    return wrapped is not None and isinstance(tensor, torch.Tensor) and wrapped(tensor)


def _scalar(value: object) -> object:
    """Return the Python number of an array or tensor without axes; anything else as it is."""
    if getattr(value, "ndim", None) == 0 and not np.ma.is_masked(value):
        return value.item()  # type: ignore[attr-defined]
    return value
