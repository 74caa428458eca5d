"""Base of all domain types: frozen models with checked arrays, stamps and frames."""

from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, PlainValidator

from rpod_schemas.bounds import Stamp, Text

Float32Array = NDArray[np.float32]


ZERO_6X6 = np.zeros((6, 6))


def _as_float32(value: Any) -> Float32Array:
    if not isinstance(value, np.ndarray) or value.dtype != np.float32:
        given = f"of {value.dtype}" if isinstance(value, np.ndarray) else f"a {type(value).__name__}"
        raise ValueError(f"is {given}, needs an array of float32: np.asarray(..., np.float32)")
    return value


def _as_image(value: Any) -> NDArray[Any]:
    if not isinstance(value, np.ndarray) or value.ndim != 2:
        given = (
            f"has shape {value.shape}" if isinstance(value, np.ndarray) else f"is a {type(value).__name__}"
        )
        raise ValueError(f"{given}, needs an array of shape (height, width)")
    return value


Floats = Annotated[Float32Array, PlainValidator(_as_float32)]


Image = Annotated[NDArray[Any], PlainValidator(_as_image)]


class Model(BaseModel):
    """Base of the domain types: frozen, closed to unknown fields, with numpy fields."""

    model_config = ConfigDict(frozen=True, extra="forbid", arbitrary_types_allowed=True)


class Stamped(Model):
    """Something measured or estimated at a time, in a frame."""

    stamp_ns: Stamp
    frame_id: Text
