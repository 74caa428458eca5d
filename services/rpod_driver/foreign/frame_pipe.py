"""Framing of frames that one process sends to another over a pipe; it needs Python 3.9 and NumPy alone.

A message is ``RPF1``, the length of a header (uint32, little-endian), the header (JSON in UTF-8), and the
bytes of arrays, one after the other, little-endian and C-contiguous::

    {"kind": "frame", "fields": {"stamp_ns": 1},
     "arrays": [{"name": "depth_m", "dtype": "<f4", "shape": [3, 4]}]}

Kinds of messages: ``info`` (the first one; the device is open), ``frame``, ``idle`` (no frame came, all is
well; a player sends the time to its next frame as ``pause_s``, s), ``error`` (field ``text``; the process
ends), ``end`` (the source has ended).
"""

import json
import os
import struct
import sys
import threading
from math import prod
from typing import Any, BinaryIO, NamedTuple

import numpy as np

MAGIC = b"RPF1"
KINDS = ("info", "frame", "idle", "error", "end")
DTYPES = ("<f4", "<f8", "|u1", "<u2", "<u4", "<i4", "<i8", "|b1")
MOST_HEADER_BYTES, MOST_BODY_BYTES = 1 << 20, 1 << 28
"""Longest header; largest body: 256 MiB, four images of the ICD's largest size."""
_PREFIX = struct.Struct("<4sI")


class Message(NamedTuple):
    """One message."""

    kind: str
    fields: "dict[str, Any]"
    arrays: "dict[str, np.ndarray]"


class Sender:
    """Writes messages to a stream."""

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream

    def send(self, kind: str, arrays: "dict[str, np.ndarray] | None" = None, **fields: Any) -> None:
        """Write a message; it is in the pipe when this returns. Raises ``OSError`` if no one reads it."""
        given = {name: np.asarray(array) for name, array in (arrays or {}).items()}
        packed = {
            name: np.asarray(array, array.dtype.newbyteorder("<"), order="C") for name, array in given.items()
        }
        told = [
            {"name": name, "dtype": array.dtype.str, "shape": list(array.shape)}
            for name, array in packed.items()
        ]
        header = json.dumps({"kind": kind, "fields": fields, "arrays": told}).encode()
        self._stream.write(_PREFIX.pack(MAGIC, len(header)) + header)
        for array in packed.values():
            self._stream.write(array.tobytes())
        self._stream.flush()


def open_sender() -> Sender:
    """Return the sender of a driver process, once.

    What the process prints goes to standard error from now on, also from compiled code. The process ends
    when its host has ended or closed standard input.
    """
    out = os.dup(1)
    os.dup2(2, 1)
    threading.Thread(target=_end_with_host, daemon=True).start()
    return Sender(os.fdopen(out, "wb"))


def _end_with_host() -> None:
    while os.read(0, 4096):
        pass
    os._exit(0)


def receive(stream: BinaryIO) -> "Message | None":
    """Return the next message; None at the end of the stream.

    Raises:
        ValueError: the bytes are no message, or are cut.
    """
    start = stream.read(_PREFIX.size)
    if not start:
        return None
    if len(start) < _PREFIX.size or not start.startswith(MAGIC):
        raise ValueError(f"a message begins with {start!r}, not with {MAGIC!r}: something else writes there")
    length = _PREFIX.unpack(start)[1]
    if length > MOST_HEADER_BYTES:
        raise ValueError(f"a header of {length} bytes, at most {MOST_HEADER_BYTES}")
    kind, fields, told = _header(_exactly(stream, length))
    return Message(kind, fields, {name: _array(stream, dtype, shape) for name, dtype, shape in told})


def _header(text: bytes) -> "tuple[str, dict[str, Any], list[tuple[str, np.dtype, tuple[int, ...]]]]":
    try:
        header = json.loads(text)
        kind, fields = header["kind"], header["fields"]
        told = [(each["name"], each["dtype"], tuple(map(int, each["shape"]))) for each in header["arrays"]]
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise ValueError(f"a header cannot be read ({type(error).__name__}: {error})") from error
    if kind not in KINDS or not isinstance(fields, dict):
        raise ValueError(f"a message of kind {kind!r}, known are {', '.join(KINDS)}")
    size = 0
    for name, dtype, shape in told:
        if dtype not in DTYPES or min(shape, default=0) < 0:
            raise ValueError(f"array {name!r} is {dtype} of shape {shape}, known are {', '.join(DTYPES)}")
        size += prod(shape) * np.dtype(dtype).itemsize
    if size > MOST_BODY_BYTES:
        raise ValueError(f"arrays of {size} bytes, at most {MOST_BODY_BYTES}")
    return kind, fields, [(str(name), np.dtype(dtype), shape) for name, dtype, shape in told]


def _array(stream: BinaryIO, dtype: "np.dtype", shape: "tuple[int, ...]") -> "np.ndarray":
    return np.frombuffer(_exactly(stream, prod(shape) * dtype.itemsize), dtype).reshape(shape)


def _exactly(stream: BinaryIO, length: int) -> bytes:
    data = stream.read(length) if length else b""
    if len(data) < length:
        raise ValueError(f"the stream ends {length - len(data)} bytes before the end of a message")
    return data


if sys.byteorder != "little":
    raise ImportError("frame_pipe needs a little-endian machine")
