"""Checked array types for pydantic models: shape, kind and finiteness, never a copy."""

import reprlib
from collections.abc import Callable
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import PlainSerializer, PlainValidator

Array = NDArray[Any]
FloatArray = NDArray[np.float64]
MAD_TO_SIGMA = 1.4826
"""Standard deviation over the median of absolute deviations, of normal errors."""


def _checked(shape: tuple[int | None, ...], *, finite: bool) -> Callable[[Any], FloatArray]:
    def check(value: Any) -> FloatArray:
        try:
            array = np.asarray(value, dtype=np.float64)
        except (TypeError, ValueError, OverflowError) as error:  # as of a mapping, a text, or lists of lists
            raise ValueError(f"is {reprlib.repr(value)}; it needs {_needed(shape)}") from error
        fits = array.ndim == len(shape) and all(
            want is None or want == have for want, have in zip(shape, array.shape, strict=True)
        )
        if not fits:
            if array.ndim == len(shape) == 1:
                raise ValueError(f"has {array.size} values; it needs {shape[0]}")
            is_one = "is one number" if array.ndim == 0 else f"has shape {array.shape}"
            raise ValueError(f"{is_one}; it needs {_needed(shape)}")
        if finite and not np.isfinite(array).all():
            raise ValueError("holds a value that is not finite")
        return array

    return check


def _needed(shape: tuple[int | None, ...]) -> str:
    """Return in words what an array of a shape holds."""
    if shape == (None,):
        return "a list of numbers, in brackets"
    count = " x ".join("N" if size is None else str(size) for size in shape)
    return f"{count} numbers, in brackets"


def _array(*shape: int | None, finite: bool = True) -> Any:
    return PlainValidator(_checked(shape, finite=finite))


_LISTED = PlainSerializer(lambda array: array.tolist(), return_type=list)

Vector3 = Annotated[FloatArray, _array(3), _LISTED]
"""A vector, shape (3,), finite."""
Matrix3 = Annotated[FloatArray, _array(3, 3), _LISTED]
"""A matrix, shape (3, 3), finite."""
Matrix6 = Annotated[FloatArray, _array(6, 6), _LISTED]
"""A matrix, shape (6, 6), finite."""
VectorN = Annotated[FloatArray, _array(None), _LISTED]
"""A vector of any length, shape (N,), finite."""
