"""Frames whose ranges are longer than they were measured."""

from functools import singledispatch

import numpy as np

from rpod_schemas.types import LidarScan, PmdFrame, SensorFrame


@singledispatch
def with_longer_ranges(
    frame: SensorFrame,
    *,
    longer_m: float = 0.0,  # noqa: ARG001 - used by those that are registered
    scale: float = 1.0,  # noqa: ARG001
) -> SensorFrame:
    """Return a frame with ranges that are multiplied by a factor and longer by a length.

    The ranges of a camera are its z-depths.

    Raises:
        TypeError: the frame is of a kind that is not registered here.
    """
    raise TypeError(f"ranges of a {type(frame).__name__} cannot be changed")


@with_longer_ranges.register
def _(frame: PmdFrame, *, longer_m: float = 0.0, scale: float = 1.0) -> PmdFrame:
    depth_m = frame.depth_m * np.float32(scale) + np.float32(longer_m)
    return frame.model_copy(update={"depth_m": depth_m})


@with_longer_ranges.register
def _(frame: LidarScan, *, longer_m: float = 0.0, scale: float = 1.0) -> LidarScan:
    range_m = np.linalg.norm(frame.points_m, axis=-1, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        factor = np.where(range_m > 0.0, scale + longer_m / range_m, scale).astype(frame.points_m.dtype)
    return frame.model_copy(update={"points_m": frame.points_m * factor})
