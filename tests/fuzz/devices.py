"""Hostile input from devices: the buffers of an ifm O3R, and the messages of a driver process."""

import io
import json
import struct
from collections.abc import Iterator
from functools import cache, partial
from random import Random

import numpy as np
from fuzz.mutation import mutate_bytes, mutate_document
from ifm_recording import recorded, tof_info_bytes

from rpod_driver.adapters.ifm.chunks import AMPLITUDE, CONFIDENCE, DISTANCE_NOISE, RADIAL_DISTANCE, TOF_INFO
from rpod_driver.adapters.ifm.chunks import buffers as buffers_of
from rpod_driver.adapters.ifm.frames import FrameMaker, images_of
from rpod_driver.errors import DriverError
from rpod_driver.foreign import frame_pipe

_SIDE = 12
"""Width and height of the images, pixels."""
_HEADER_BYTES = 48
_IMAGES = (RADIAL_DISTANCE, AMPLITUDE, DISTANCE_NOISE, CONFIDENCE)


def device_subjects() -> Iterator[tuple[str, partial[bytes], partial[bool]]]:
    """Yield the name of each subject, what makes its inputs, and what reads them."""
    yield "ifm buffer", partial(_make_buffer), partial(_read_buffer)
    yield "driver process", partial(_make_messages), partial(_read_messages)


@cache
def _chunks() -> tuple[tuple[int, int, bytes, dict[str, object]], ...]:
    """Return type, pixel format, data and metadata of each chunk of a small recording."""
    found = recorded()
    images = [
        (kind, found[kind].pixel_format, found[kind].image()[:_SIDE, :_SIDE].tobytes(), found[kind].metadata)
        for kind in _IMAGES
        if kind in found
    ]
    return (*images, (TOF_INFO, 0, tof_info_bytes(), {}))


def _make_buffer(rnd: Random) -> bytes:
    """Return a buffer in which metadata, data, sizes or any bytes are changed."""
    body, where = b"", rnd.randrange(3)
    for kind, pixels, data, metadata in _chunks():
        document, content, changed = metadata, data, rnd.randrange(4) == 0
        if changed and where == 0:
            document = mutate_document(rnd, metadata or {"DistanceResolution": 1.0})
        if changed and where == 1:
            content = mutate_bytes(rnd, data)
        text = json.dumps(document).encode()
        size = _HEADER_BYTES + len(text)
        head = (kind, size + len(content), size, 3, _SIDE, _SIDE, pixels, 1, 2, 0, 3, 4)
        body += struct.pack("<12I", *head) + text + content
    buffer = b"0000star" + body + b"stop\r\n"
    return mutate_bytes(rnd, buffer) if where == 2 else buffer


def _read_buffer(content: bytes) -> bool:
    try:
        for chunks in buffers_of(content, "fuzz"):
            FrameMaker(None).frame(images_of(chunks), 1)
    except DriverError:
        return False
    return True


def _make_messages(rnd: Random) -> bytes:
    stream = io.BytesIO()
    sender = frame_pipe.Sender(stream)
    sender.send("info", sigma_range_m=0.01)
    sender.send("frame", {"points_m": np.zeros((3, 4, 3), np.float32)}, stamp_ns=1)
    return mutate_bytes(rnd, stream.getvalue())


def _read_messages(content: bytes) -> bool:
    stream = io.BytesIO(content)
    try:
        while frame_pipe.receive(stream) is not None:
            pass
    except ValueError:
        return False
    return True
