"""Whatever holds numbers, as arrays of rows and columns."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def _array(value: Any) -> NDArray[Any]:
    """An array of what is one, has ``__array__`` or speaks DLPack."""
    if isinstance(value, np.ndarray):
        return value
    # Tensors that gradients belong to, or that lie on a device, hand out no memory of their own accord.
    for step in ("detach", "cpu"):
        if callable(getattr(value, step, None)):
            value = getattr(value, step)()
    if str(getattr(value, "dtype", "")).endswith("bfloat16") and callable(getattr(value, "float", None)):
        value = value.float()
    if not hasattr(value, "__array__") and hasattr(value, "__dlpack__"):
        return np.from_dlpack(value)
    return np.asarray(value)


def _two_dimensions(array: NDArray[Any]) -> NDArray[Any]:
    if array.ndim != 2:
        raise ValueError(f"its shape is {list(array.shape)}; it should have two dimensions, rows and columns")
    return array


def floats(value: Any) -> NDArray[np.float32]:
    """A map of floats, rows and columns, in single precision."""
    array = _two_dimensions(_array(value))
    if array.dtype.kind != "f":
        raise ValueError(
            f"its type is `{array.dtype}`, not floats of 16, 32 or 64 bits; convert it with "
            "array.astype('float32') if its numbers are what `meaning` says"
        )
    # What single precision cannot hold becomes infinite and is refused as such.
    with np.errstate(over="ignore"):
        return np.ascontiguousarray(array, dtype=np.float32)


def labels(value: Any) -> NDArray[np.uint8]:
    """A map of label ids from 0 to 255."""
    array = _two_dimensions(_array(value))
    if array.dtype.kind not in "iu":
        raise ValueError(f"its type is `{array.dtype}`, not integers, which labels are")
    if array.size and (array.min() < 0 or array.max() > 255):
        raise ValueError(f"labels lie between 0 and 255, and there are some from {array.min()} to {array.max()}")
    return np.ascontiguousarray(array, dtype=np.uint8)
