"""Point clouds."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rpod_schemas.bounds import RETURN_TIME_S, SCAN_DIRECTIONS
from rpod_schemas.errors import MessageRejectedError, Reason
from rpod_schemas.messages.header import read_stamp, within, write_header
from rpod_schemas.rmw.cdr import NANOSECONDS, message_class

_FLOAT32 = 7
_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", _FLOAT32: "f4", 8: "f8"}
"""Types of numpy by the datatype of a sensor_msgs/PointField."""
_TIMES = ("t", "time", "timestamp", "offset_time", "time_stamp")
"""Names under which drivers send the time of a point."""
_STRENGTHS = ("intensity", "reflectivity")
_LONGEST_S = 10.0
"""Longest scan by which the unit of a time is recognised; ``t`` is always in seconds if it is a float."""
_UNITS_S = (1.0, 1e-3, 1e-6, 1e-9)
_LEAST_SPREAD = 1e-3
"""Least spread of relative times over their greatest value; a clock that runs since power-up has less."""


def read_points(message: Any) -> dict[str, NDArray[np.float32]]:
    """Return the fields of a PointCloud2, each (rows, columns) if organised, else (N,).

    The fields are ``x``, ``y`` and ``z``, ``intensity``, and ``t``, the time from the stamp in seconds, if
    they were sent, in any of ROS's numeric types and under the names that drivers use. Times whose meaning is
    unknown are left out. Fields that are float32 are views.
    """
    _check_size(message)
    if 0 in (message.width, message.height):
        raise MessageRejectedError(Reason.EMPTY, "a cloud of no points")
    within(SCAN_DIRECTIONS, "number of points", message.width * message.height)
    places = {item.name: item for item in message.fields}
    names = {"x": ("x",), "y": ("y",), "z": ("z",), "intensity": _STRENGTHS}
    fields: dict[str, NDArray[np.float32]] = {}
    for name, known in names.items():
        item = next((places[each] for each in known if each in places), None)
        if item is not None:
            fields[name] = _values(message, item).astype(np.float32, copy=False)
    missing = {"x", "y", "z"} - set(fields)
    if missing:
        raise MessageRejectedError(
            Reason.WRONG_TYPE, f"point fields {', '.join(sorted(missing))} are missing"
        )
    if (item := time_field(message)) is not None:
        time_s = _relative_s(item.name, _values(message, item), read_stamp(message.header), fields)
        if time_s is not None:
            fields["t"] = within_scan(time_s)
    return fields


def _check_size(message: Any) -> None:
    """Raise an error if a cloud's data are shorter than its points; the row_step of one row is not read.

    velodyne_pointcloud left it at 0 until 2021, as did others.
    """
    row = message.point_step * message.width
    row_step = message.row_step if message.height > 1 else row
    if row_step < row:
        raise MessageRejectedError(
            Reason.WRONG_SIZE,
            f"row_step is {row_step:,} bytes, needs {row:,} or more (width {message.width:,} times point_step"
            f" {message.point_step}): let its driver set row_step, or send one row (height 1)",
        )
    if message.data.size < row_step * (message.height - 1) + row:
        raise MessageRejectedError(
            Reason.WRONG_SIZE,
            f"{message.width} x {message.height} points of {message.point_step} in {message.data.size} bytes",
        )


def time_field(message: Any) -> Any | None:
    """Return the sensor_msgs/PointField with the times of a cloud's points; None if it has none."""
    places = {item.name: item for item in message.fields}
    return next((places[name] for name in _TIMES if name in places), None)


def within_scan(time_s: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the times of N points, s from the stamp, shape (N,).

    Raises:
        MessageRejectedError: they are not of one scan.
    """
    within(RETURN_TIME_S, "t", time_s[~np.isnan(time_s)])
    return time_s


def _values(message: Any, item: Any) -> NDArray[Any]:
    """Return a field of all points as a view, (rows, columns) or (N,)."""
    dtype = np.dtype(_TYPES.get(item.datatype, "V0")).newbyteorder(">" if message.is_bigendian else "<")
    if not dtype.itemsize or item.count > 1 or item.offset + dtype.itemsize > message.point_step:
        raise MessageRejectedError(
            Reason.WRONG_TYPE, f"point field {item.name!r} is no number within the point"
        )
    shape = (message.height, message.width) if message.height > 1 else (message.width,)
    strides = (message.row_step, message.point_step)[2 - len(shape) :]
    return np.ndarray(shape, dtype, message.data, offset=item.offset, strides=strides)


def _relative_s(
    name: str, times: NDArray[Any], stamp_ns: int, fields: dict[str, NDArray[np.float32]]
) -> NDArray[np.float32] | None:
    """Return times as seconds from the stamp; None if they are neither relative to it nor absolute.

    Integers are nanoseconds. A float32 ``t`` is in seconds from the stamp. Other numbers are relative, in
    the largest unit in which a scan takes 10 s at most, or absolute, in the unit in which they are near the
    stamp.
    """
    if times.dtype.kind == "f" and name == "t" and times.dtype.itemsize == 4:
        return times.astype(np.float32, copy=False)
    returned = np.isfinite(fields["x"]) & ((fields["x"] != 0) | (fields["y"] != 0) | (fields["z"] != 0))
    sample = times[returned & np.isfinite(times)].astype(np.float64)
    if not sample.size:
        return None
    integers = times.dtype.kind in "iu"
    least, most = float(sample.min()), float(sample.max())
    relative = most - least >= _LEAST_SPREAD * max(abs(least), abs(most))
    for unit_s in _UNITS_S[-1:] if integers else _UNITS_S:
        if relative and max(abs(least), abs(most)) * unit_s <= _LONGEST_S:
            return _of_returns((times * unit_s).astype(np.float32), returned)
        stamp = stamp_ns / NANOSECONDS / unit_s
        if max(abs(least - stamp), abs(most - stamp)) * unit_s <= RETURN_TIME_S.high:
            return _of_returns(((times - stamp) * unit_s).astype(np.float32), returned)
    return None


def _of_returns(time_s: NDArray[np.float32], returned: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return times, s, NaN where a ray without a return has none: drivers fill such points with zeros."""
    inside = (time_s >= RETURN_TIME_S.low) & (time_s <= RETURN_TIME_S.high)
    return np.where(returned | inside, time_s, np.float32(np.nan))


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
