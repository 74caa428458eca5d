"""Point clouds."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rpod_schemas.bounds import RETURN_TIME_S, SCAN_DIRECTIONS
from rpod_schemas.cdr import message_class
from rpod_schemas.errors import MessageRejectedError, Reason
from rpod_schemas.messages.header import within, write_header

_FLOAT32 = 7


def read_points(message: Any) -> dict[str, NDArray[np.float32]]:
    """Return the fields of a PointCloud2, each (rows, columns) if organised, else (N,).

    The fields are ``x``, ``y`` and ``z``, and ``intensity`` and ``t`` if they were sent. They are views,
    unless the bytes are big-endian.
    """
    row = message.point_step * message.width
    if message.row_step < row or message.data.size < message.row_step * (message.height - 1) + row:
        raise MessageRejectedError(
            Reason.WRONG_SIZE,
            f"{message.width} x {message.height} points of {message.point_step} in {message.data.size} bytes",
        )
    if 0 in (message.width, message.height):
        raise MessageRejectedError(Reason.EMPTY, "a cloud of no points")
    within(SCAN_DIRECTIONS, "number of points", message.width * message.height)
    order = ">" if message.is_bigendian else "<"
    shape = (message.height, message.width) if message.height > 1 else (message.width,)
    strides = (message.row_step, message.point_step)[2 - len(shape) :]
    fields: dict[str, NDArray[np.float32]] = {}
    for item in message.fields:
        if item.name not in ("x", "y", "z", "intensity", "t"):
            continue
        if item.datatype != _FLOAT32 or item.count > 1 or item.offset + 4 > message.point_step:
            raise MessageRejectedError(
                Reason.WRONG_TYPE, f"point field {item.name!r} is no float32 within the point"
            )
        values = np.ndarray(shape, f"{order}f4", message.data, offset=item.offset, strides=strides)
        fields[item.name] = values.astype(np.float32, copy=False)
    missing = {"x", "y", "z"} - set(fields)
    if missing:
        raise MessageRejectedError(
            Reason.WRONG_TYPE, f"point fields {', '.join(sorted(missing))} are missing"
        )
    if "t" in fields:
        within(RETURN_TIME_S, "t", fields["t"][~np.isnan(fields["t"])])
    return fields


def write_points(stamp_ns: int, frame_id: str, fields: dict[str, NDArray[np.float32]]) -> Any:
    """Return an organised PointCloud2 of float32 fields of one shape, (rows, columns) or (N,)."""
    names = list(fields)
    packed = np.stack([fields[name] for name in names], axis=-1).astype("<f4", copy=False)
    height, width = packed.shape[:2] if packed.ndim == 3 else (1, packed.shape[0])
    point_step = 4 * len(names)
    field_class = message_class("sensor_msgs/msg/PointField")
    return message_class("sensor_msgs/msg/PointCloud2")(
        header=write_header(stamp_ns, frame_id),
        height=height,
        width=width,
        fields=[
            field_class(name=name, offset=4 * index, datatype=_FLOAT32, count=1)
            for index, name in enumerate(names)
        ],
        is_bigendian=False,
        point_step=point_step,
        row_step=point_step * width,
        data=packed.reshape(-1).view(np.uint8),
        is_dense=bool(np.isfinite(packed).all()),
    )
