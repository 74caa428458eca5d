"""Hostile compressed images: in the codecs of image_transport, and in the project's own."""

from collections.abc import Callable
from functools import cache
from random import Random

import cv2
import numpy as np
from fuzz.mutation import mutate_bytes, mutate_message

from rpod_runtime.sensor_data.codecs import decompressed
from rpod_runtime.sensor_data.shuffled import compressed
from rpod_schemas.errors import MessageRejectedError
from rpod_schemas.messages import read_amplitude, read_depth, write_compressed
from rpod_schemas.rmw.cdr import decode, encode
from rpod_schemas.topics import COMPRESSED_IMAGE

NAME = "compressed image"


@cache
def _seeds() -> tuple[bytes, ...]:
    """Return valid messages, one of each codec."""
    counts = np.arange(48, dtype=np.uint16).reshape(6, 8)
    png = cv2.imencode(".png", counts)[1].ravel()
    jpeg = cv2.imencode(".jpg", counts.astype(np.uint8))[1].ravel()
    depth = np.concatenate([np.zeros(12, np.uint8), png])
    pictures = (
        compressed(1, "cam", counts.astype(np.float32), "32FC1"),
        write_compressed(1, "cam", "mono16; png compressed mono16", png),
        write_compressed(1, "cam", "mono8; jpeg compressed mono8", jpeg),
        write_compressed(1, "cam", "16UC1; compressedDepth png", depth),
    )
    return tuple(bytes(encode(picture)) for picture in pictures)


def make(rnd: Random) -> bytes:
    """Return a hostile compressed image, sometimes with the bytes of its codec alone changed."""
    seed = rnd.choice(_seeds())
    if rnd.randrange(2):
        return mutate_message(rnd, seed, COMPRESSED_IMAGE)
    message = decode(seed, COMPRESSED_IMAGE)
    data = np.frombuffer(mutate_bytes(rnd, message.data.tobytes()), np.uint8)
    return bytes(encode(write_compressed(1, "cam", message.format, data)))


def read(payload: bytes) -> bool:
    """Read a compressed image as a camera's reader does; return whether it was accepted."""
    readers: tuple[Callable[[object], object], ...] = (read_depth, read_amplitude)
    accepted = False
    for each in readers:
        try:
            each(decompressed(decode(memoryview(payload), COMPRESSED_IMAGE)))
            accepted = True
        except MessageRejectedError:
            continue
    return accepted
