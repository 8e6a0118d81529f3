"""Arguments of queries: checked, and brought into one form."""

from collections.abc import Sequence

import numpy as np
import torch

from objectfolder.errors import ObjectFolderError

#: What a query takes for rows of numbers: any real dtype, any strides.
Rows = np.ndarray | torch.Tensor | Sequence[float] | Sequence[Sequence[float]]
#: A number for all rows, or one for each.
Scalars = float | np.ndarray | torch.Tensor | Sequence[float]


def numbers(name: str, values: object) -> np.ndarray:
    """Real numbers as a float64 array of its own; tensors come from their device, without gradients.

    Raises
    ------
    ObjectFolderError
        If they are not real numbers, or not a rectangular array.
    """
    if isinstance(values, torch.Tensor):
        if values.is_complex():
            raise ObjectFolderError(f"{name} holds {values.dtype}, expected real numbers")
        return values.detach().to("cpu", torch.float64).numpy()
    try:
        array = np.asarray(values)
    except ValueError as error:
        raise ObjectFolderError(f"{name} is not an array of numbers: {error}") from error
    if array.dtype.kind not in "fiu" and array.size:
        raise ObjectFolderError(f"{name} holds {array.dtype}, expected real numbers")
    return array.astype(np.float64)


def rows(name: str, values: object, width: int) -> np.ndarray:
    """Check an (N, width) array of finite numbers; one row may come without its first axis."""
    array = numbers(name, values)
    if array.ndim == 1 and len(array) == width:
        array = array[None]
    if array.ndim != 2 or array.shape[1] != width:
        raise ObjectFolderError(f"{name} has shape {array.shape}, expected (N, {width})")
    wrong = np.flatnonzero(~np.isfinite(array).all(1))
    if len(wrong):
        raise ObjectFolderError(
            f"{name}: row {wrong[0]} is {array[wrong[0]].tolist()}, expected finite numbers"
        )
    return array


def paired(a_name: str, a: np.ndarray, b_name: str, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Give two arrays as many rows; one row serves all of the other's."""
    if len(a) != len(b) and 1 not in (len(a), len(b)):
        raise ObjectFolderError(f"{a_name} has {len(a)} rows, {b_name} {len(b)}; expected as many, or one")
    count = len(b) if len(a) == 1 else len(a)
    first, second = (np.repeat(x, count, 0) if len(x) == 1 else x for x in (a, b))
    return first, second


def scalars(name: str, values: object, count: int) -> np.ndarray:
    """Check one finite number, or ``count`` of them; (count,)."""
    array = numbers(name, values)
    if array.ndim > 1 or array.size not in (1, count):
        raise ObjectFolderError(f"{name} has shape {array.shape}, expected one number or {count} of them")
    wrong = np.flatnonzero(~np.isfinite(array))
    if len(wrong):
        raise ObjectFolderError(f"{name}: row {wrong[0]} is {array.flat[wrong[0]]}, expected finite numbers")
    return np.broadcast_to(array.reshape(-1), (count,)) if array.size == 1 else array


def alike(answer: np.ndarray, question: object) -> np.ndarray | torch.Tensor:
    """Return an answer as a tensor on the question's device, if the question was one."""
    return torch.from_numpy(answer).to(question.device) if isinstance(question, torch.Tensor) else answer
