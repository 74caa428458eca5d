"""Images in a codec's bytes (sensor_msgs/CompressedImage) as plain ones, by OpenCV.

The codec ``shuffle zstd`` is this project's own, and loses nothing. The topics of image_transport end in
``/compressed`` (PNG or JPEG) and ``/compressedDepth`` (a header of 12 bytes, then PNG). Only 16UC1 keeps its
values in ``compressedDepth``; 32FC1 is quantised by inverse depth.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rpod_runtime.sensor_data.shuffled import CODEC, expanded
from rpod_schemas.bounds import IMAGE_PIXELS, IMAGE_SIDE
from rpod_schemas.errors import MessageRejectedError, Reason
from rpod_schemas.messages import read_stamp, write_image
from rpod_schemas.messages.header import within

_DEPTH_HEADER_BYTES = 12
"""Size of compressed_depth_image_transport's ConfigHeader."""
_PNG, _JPEG = b"\x89PNG\r\n\x1a\n", b"\xff\xd8"
_CHUNK_BYTES = 12
"""Length, type and checksum of a chunk of PNG (W3C, PNG, section 5.3)."""
_START_OF_FRAME = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
"""Markers of JPEG after which the size stands (ITU-T T.81, table B.1)."""
_FILL = 0xFF
_ALONE = frozenset({0x00, 0x01, *range(0xD0, 0xDA)})
"""Markers without a length; none of them stands between the first one and the frame."""
_LEAST_LENGTH = 2
_ENCODINGS = {"uint8": "mono8", "uint16": "mono16"}


def decompressed(message: Any) -> Any:
    """Return the sensor_msgs/Image of a sensor_msgs/CompressedImage.

    Raises:
        MessageRejectedError: the codec loses depth, is not supported, or its bytes are damaged.
    """
    encoding, _, codec = (part.strip() for part in message.format.partition(";"))
    data = np.asarray(message.data, np.uint8)
    if codec == CODEC:
        plain = expanded(data, encoding)
        return write_image(read_stamp(message.header), message.header.frame_id, plain, encoding)
    if "compressedDepth" in message.format:
        if encoding != "16UC1":
            raise MessageRejectedError(
                Reason.WRONG_TYPE,
                f"compressedDepth of {encoding!r} loses depth; let the driver send 16UC1, or listen to the "
                "image that is not compressed",
            )
        if "rvl" in codec:
            raise MessageRejectedError(
                Reason.WRONG_TYPE, "compressedDepth in RVL is not supported; set its format to png"
            )
        data = data[_DEPTH_HEADER_BYTES:]
    _check_size(data)
    import cv2  # noqa: PLC0415 - only who reads such images needs it

    try:
        image = cv2.imdecode(data, cv2.IMREAD_UNCHANGED) if data.size else None
    except cv2.error:  # a header that OpenCV does not accept; usually it returns None
        image = None
    if image is None:
        raise MessageRejectedError(
            Reason.MALFORMED, f"{message.format!r} in {data.size} bytes cannot be decoded"
        )
    if image.ndim != 2 or image.dtype.name not in _ENCODINGS:
        raise MessageRejectedError(
            Reason.WRONG_TYPE,
            f"{message.format!r} holds {image.shape[2:] or 1} channels of {image.dtype}, needs one of "
            "uint8 or uint16",
        )
    known = "16UC1" if encoding == "16UC1" else _ENCODINGS[image.dtype.name]
    return write_image(read_stamp(message.header), message.header.frame_id, image, known)


def _check_size(data: NDArray[np.uint8]) -> None:
    """Check the size that PNG or JPEG states: a few bytes must not fill the memory."""
    size = _png_size(data) or _jpeg_size(data)
    if size is None:
        raise MessageRejectedError(
            Reason.MALFORMED, f"{data.size} bytes cannot be decoded: they are neither PNG nor JPEG"
        )
    height, width = size
    within(IMAGE_SIDE, "width", width)
    within(IMAGE_SIDE, "height", height)
    within(IMAGE_PIXELS, "width x height", width * height)
    if data[0] == _PNG[0]:
        _check_chunks(data)


def _png_size(data: NDArray[np.uint8]) -> tuple[int, int] | None:
    if data.size < 24 or data[:8].tobytes() != _PNG:
        return None
    return int.from_bytes(data[20:24].tobytes()), int.from_bytes(data[16:20].tobytes())


def _check_chunks(data: NDArray[np.uint8]) -> None:
    """Check that the chunks of a PNG are in it: a decoder would ask for as much memory as they state."""
    at, kind = len(_PNG), b""
    while kind != b"IEND":
        length, kind = int.from_bytes(data[at : at + 4].tobytes()), data[at + 4 : at + 8].tobytes()
        at += _CHUNK_BYTES + length
        if at > data.size:
            raise MessageRejectedError(
                Reason.MALFORMED,
                f"PNG cannot be decoded: its chunks state at least {at} bytes, it has {data.size}",
            )


def _jpeg_size(data: NDArray[np.uint8]) -> tuple[int, int] | None:
    if data[:2].tobytes() != _JPEG:
        return None
    at = 2
    while at + 9 <= data.size and data[at] == 0xFF:
        marker, length = int(data[at + 1]), int.from_bytes(data[at + 2 : at + 4].tobytes())
        if marker == _FILL:  # any number of them may stand before a marker
            at += 1
            continue
        if marker in _START_OF_FRAME:
            return int.from_bytes(data[at + 5 : at + 7].tobytes()), int.from_bytes(
                data[at + 7 : at + 9].tobytes()
            )
        if marker in _ALONE or length < _LEAST_LENGTH:
            return None  # a decoder would look for the size elsewhere
        at += 2 + length
    return None
