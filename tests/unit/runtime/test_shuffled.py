"""The lossless codec of images, and the bounds that keep a small message from becoming a large image."""

import struct

import cv2
import numpy as np
import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st

from rpod_runtime.sensor_data.codecs import decompressed
from rpod_runtime.sensor_data.shuffled import CODEC, compressed, expanded
from rpod_schemas.errors import MessageRejectedError
from rpod_schemas.messages import read_image, write_compressed

TYPES = {"32FC1": np.float32, "16UC1": np.uint16, "mono16": np.uint16, "mono8": np.uint8, "16UC4": np.uint16}


@given(st.sampled_from(sorted(TYPES)), st.integers(1, 40), st.integers(1, 40), st.integers(0, 2**32 - 1))
def test_an_image_comes_back_to_the_bit(encoding, height, width, seed):
    shape = (height, width, 4) if encoding == "16UC4" else (height, width)
    raw = np.random.default_rng(seed).integers(0, 256, (*shape, TYPES[encoding]().itemsize), np.uint8)
    image = raw.view(TYPES[encoding])[..., 0]
    back = decompressed(compressed(5, "cam", image, encoding))
    assert read_image(back).tobytes() == image.tobytes()
    assert (back.height, back.width, back.encoding) == (height, width, encoding)


def damaged(height, width, step, packed):
    return np.frombuffer(struct.pack("<III", height, width, step) + packed, np.uint8)


ZEROS = zstandard.compress(b"\0" * 400)
UNSIZED = zstandard.ZstdCompressor(write_content_size=False).compress(b"\0" * 400)
BOMB = zstandard.compress(b"\0" * (1 << 26))


@pytest.mark.parametrize(
    ("data", "text"),
    [
        (damaged(10, 10, 40, ZEROS)[:11], "has no head"),
        (damaged(10, 9000, 36_000, ZEROS), "width is 9,000"),
        (damaged(8192, 8192, 32_768, ZEROS), "width x height"),
        (damaged(10, 10, 41, ZEROS), "10 32FC1 pixels a row in 41 bytes"),
        (damaged(10, 11, 44, ZEROS), "does not hold 10 rows of 44 bytes"),
        (damaged(10, 10, 40, BOMB), "does not hold 10 rows of 40 bytes"),
        (damaged(10, 10, 40, UNSIZED), "does not hold"),
        (damaged(10, 10, 40, ZEROS[:-3]), "zstd"),
        (damaged(10, 10, 40, b"no frame at all"), "zstd"),
    ],
)
def test_damaged_data_and_bombs_are_rejected_before_they_are_unpacked(data, text):
    with pytest.raises(MessageRejectedError, match=text):
        expanded(data, "32FC1")


def test_a_message_with_an_unknown_encoding_is_rejected():
    with pytest.raises(MessageRejectedError, match="64FC1"):
        decompressed(write_compressed(1, "", f"64FC1; {CODEC}", damaged(10, 10, 40, ZEROS)))


def png(width, height):
    return (
        b"\x89PNG\r\n\x1a\n" + struct.pack(">I4sII", 13, b"IHDR", width, height) + b"\x10\0\0\0\0" + bytes(9)
    )


def jpeg(width, height):
    return b"\xff\xd8\xff\xe0\0\x04ab" + b"\xff\xc0\0\x0b\x08" + struct.pack(">HH", height, width) + bytes(9)


@pytest.mark.parametrize("data", [png(60_000, 60_000), jpeg(60_000, 60_000), png(8192, 8192)])
def test_a_picture_that_says_that_it_is_huge_is_rejected(data):
    with pytest.raises(MessageRejectedError, match="width"):
        decompressed(write_compressed(1, "", "mono16; png", np.frombuffer(data, np.uint8)))
    with pytest.raises(MessageRejectedError, match="neither PNG nor JPEG"):
        decompressed(write_compressed(1, "", "mono16; png", np.frombuffer(b"GIF89a" + bytes(40), np.uint8)))


def hidden_jpeg(width, height, before):
    """Return a picture whose size a decoder finds behind some bytes.

    A reader that takes these bytes for a marker with a length finds a small size farther on.
    """
    frame = b"\xff\xc0\0\x0b\x08" + struct.pack(">HH", height, width) + b"\x01\x01\x11\0"
    head = b"\xff\xd8" + before + frame
    farther = 4 + int.from_bytes(head[4:6])
    return head + bytes(farther - len(head)) + jpeg(10, 10)[8:]


@pytest.mark.parametrize("before", [b"\xff", b"\xff\xff\xff", b"\xff\xd0", b"\xff\x01"])
def test_the_size_of_a_jpeg_is_read_where_a_decoder_reads_it(before):
    data = np.frombuffer(hidden_jpeg(60_000, 60_000, before), np.uint8)
    with pytest.raises(MessageRejectedError, match=r"width is 60,000|neither PNG nor JPEG"):
        decompressed(write_compressed(1, "", "mono8; jpeg", data))


def test_an_error_of_the_decoder_is_a_rejection(monkeypatch):
    def refuse(*_: object) -> None:
        raise cv2.error("(-215:Assertion failed) pixels <= CV_IO_MAX_IMAGE_PIXELS")

    monkeypatch.setattr(cv2, "imdecode", refuse)
    with pytest.raises(MessageRejectedError, match="cannot be decoded"):
        decompressed(write_compressed(1, "", "mono16; png", np.frombuffer(png(10, 10), np.uint8)))
