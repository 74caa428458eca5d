"""A message as plain data, the same whichever reader it came from: what JSON can say, bytes by digest."""

import math
from dataclasses import fields, is_dataclass
from hashlib import sha256
from typing import Any

import numpy as np

Plain = Any
"""What ``json.loads`` returns."""


def plain(value: Any) -> Plain:
    """Return a message, or what is in it, as plain data; bytes by their number and digest."""
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return "NaN" if math.isnan(value) else "Infinity" if value > 0 else "-Infinity"
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, bytes | bytearray | memoryview) or getattr(value, "dtype", None) == np.uint8:
        # Some readers give an empty list of bytes as a list of anything.
        return {"bytes": len(value), "sha256": sha256(value).hexdigest()} if len(value) else []
    if isinstance(value, np.ndarray | list | tuple) or hasattr(value, "typecode"):
        return [plain(item) for item in value]
    return {name: plain(item) for name, item in _fields(value).items()}


def _fields(message: Any) -> dict[str, Any]:
    """Return the fields of a rosbags dataclass, an mcap_ros2 message, or a row of Arrow."""
    if isinstance(message, dict):
        return message
    if is_dataclass(message):  # where constants, in capitals, and the type are fields too
        names = [name for name in (item.name for item in fields(message)) if name[0].islower()]
    else:
        names = message.__slots__
    return {name: getattr(message, name) for name in names}
