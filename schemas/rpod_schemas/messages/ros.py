"""Messages of ROS 2 nodes: log lines, parameters, and the service that resets the estimator."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from rpod_schemas.bounds import check_covariance
from rpod_schemas.control import ResetRequest
from rpod_schemas.errors import MessageRejectedError, Reason
from rpod_schemas.messages.geometry import read_pose
from rpod_schemas.messages.header import accepted, build, read_stamp, write_stamp
from rpod_schemas.rmw.cdr import message_class
from rpod_schemas.topics import CHASER

ParameterValue = bool | int | float | str | list[bool] | list[int] | list[float] | list[str] | bytes | None
"""Value of a parameter; None where it is not set."""

NOT_SET = 0
TYPE_NAMES = (
    "not set", "bool", "integer", "double", "string",
    "byte array", "bool array", "integer array", "double array", "string array",
)  # fmt: skip
"""Names of the types of rcl_interfaces/ParameterType, by their number."""

_FIELDS = (
    "", "bool_value", "integer_value", "double_value", "string_value", "byte_array_value",
    "bool_array_value", "integer_array_value", "double_array_value", "string_array_value",
)  # fmt: skip
"""Field of rcl_interfaces/ParameterValue that holds a value, by the number of its type."""
_BYTES, _BOOLS, _INTEGERS, _DOUBLES, _STRINGS = 5, 6, 7, 8, 9
_SCALARS: tuple[tuple[type, int], ...] = ((bool, 1), (int, 2), (float, 3), (str, 4))
_DTYPES = {_BYTES: np.uint8, _BOOLS: np.bool_, _INTEGERS: np.int64, _DOUBLES: np.float64}


def parameter_type(value: ParameterValue) -> int:
    """Return the number of a value's type (rcl_interfaces/ParameterType)."""
    if value is None:
        return NOT_SET
    if isinstance(value, bytes):
        return _BYTES
    if isinstance(value, list):
        scalar = parameter_type(value[0]) if value else _STRINGS - _BYTES
        return scalar + _BYTES
    return next(number for kind, number in _SCALARS if isinstance(value, kind))


def write_parameter_value(value: ParameterValue) -> Any:
    """Return a rcl_interfaces/ParameterValue."""
    number = parameter_type(value)
    fields: dict[str, Any] = {
        "type": number,
        "bool_value": False,
        "integer_value": 0,
        "double_value": 0.0,
        "string_value": "",
        **{_FIELDS[array]: np.empty(0, dtype) for array, dtype in _DTYPES.items()},
        "string_array_value": [],
    }
    if number == _BYTES and isinstance(value, bytes):
        fields[_FIELDS[number]] = np.frombuffer(value, np.uint8)
    elif number in _DTYPES:
        fields[_FIELDS[number]] = np.array(value, _DTYPES[number])
    elif number != NOT_SET:
        fields[_FIELDS[number]] = value
    return message_class("rcl_interfaces/msg/ParameterValue")(**fields)


def read_parameter_value(message: Any) -> ParameterValue:
    """Read a rcl_interfaces/ParameterValue.

    Raises:
        MessageRejectedError: its type is unknown.
    """
    number = int(message.type)
    if number >= len(_FIELDS):
        raise MessageRejectedError(Reason.MALFORMED, f"type {number} of a parameter, needs 0 to 9")
    if number == NOT_SET:
        return None
    value: Any = getattr(message, _FIELDS[number])
    if number == _BYTES:
        return bytes(value)
    plain: ParameterValue = value.tolist() if number in _DTYPES else value
    return plain


def write_parameter(name: str, value: ParameterValue) -> Any:
    """Return a rcl_interfaces/Parameter."""
    return message_class("rcl_interfaces/msg/Parameter")(name=name, value=write_parameter_value(value))


def write_parameter_event(
    stamp_ns: int, node: str, *, new: Sequence[Any] = (), changed: Sequence[Any] = ()
) -> Any:
    """Return a rcl_interfaces/ParameterEvent of a node's new and changed parameters."""
    return message_class("rcl_interfaces/msg/ParameterEvent")(
        stamp=write_stamp(stamp_ns),
        node=node,
        new_parameters=list(new),
        changed_parameters=list(changed),
        deleted_parameters=[],
    )


def write_log(stamp_ns: int, *, level: int, name: str, text: str, file: str, function: str, line: int) -> Any:
    """Return a rcl_interfaces/Log; level is 10 (DEBUG), 20, 30, 40 or 50 (FATAL)."""
    return message_class("rcl_interfaces/msg/Log")(
        stamp=write_stamp(stamp_ns), level=level, name=name, msg=text, file=file, function=function, line=line
    )


def read_reset(message: Any) -> ResetRequest:
    """Read a rpod_msgs/ResetEstimator_Request.

    Raises:
        MessageRejectedError: the pose, its covariance or the gid is not valid; the text names the field.
    """
    gid = {"keep_gid": message.keep_gid} if message.keep_gid else {}
    given = message.pose
    if not message.with_pose:
        position = given.pose.pose.position
        if any((position.x, position.y, position.z)):
            raise MessageRejectedError(
                Reason.MALFORMED,
                "with_pose is false, but a pose is given: set it to true, or leave the pose out",
            )
        return build(ResetRequest, **gid)
    covariance = np.asarray(given.pose.covariance, np.float64).reshape(6, 6)
    return build(
        ResetRequest,
        pose=read_pose(given.pose.pose),
        frame_id=given.header.frame_id or CHASER,
        stamp_ns=read_stamp(given.header) or None,
        covariance=accepted(check_covariance, "covariance", covariance) if covariance.any() else None,
        **gid,
    )
