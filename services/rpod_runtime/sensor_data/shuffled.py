"""The codec ``shuffle zstd``: lossless images of any encoding, as sensor_msgs/CompressedImage (ICD 2).

The bytes of equal significance of all pixels stand together (byte shuffle), because sign, exponent and the
first bits of the mantissa of neighbouring pixels are alike; Zstandard (RFC 8878) then packs them. ``data``
begins with height, width and step (bytes of a row), uint32 each, little-endian; one Zstandard frame follows,
whose header states its size.
"""

import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rpod_schemas.bounds import IMAGE_PIXELS, IMAGE_SIDE
from rpod_schemas.errors import MessageRejectedError, Reason
from rpod_schemas.messages import pixel_format, write_compressed
from rpod_schemas.messages.header import within

CODEC = "shuffle zstd"
_HEAD = struct.Struct("<III")
_LEVEL = 1
"""Level of Zstandard: higher ones take several times as long for some percent."""


def compressed(stamp_ns: int, frame_id: str, image: NDArray[Any], encoding: str) -> Any:
    """Return an image, (height, width) or (height, width, channels), as a sensor_msgs/CompressedImage."""
    import zstandard  # noqa: PLC0415 - of an extra

    height, width = image.shape[:2]
    step = image[0].nbytes
    size = image.dtype.itemsize
    raw = np.ascontiguousarray(image, image.dtype.newbyteorder("<")).reshape(-1).view(np.uint8)
    planes = np.ascontiguousarray(raw.reshape(-1, size).T)
    packed = zstandard.ZstdCompressor(level=_LEVEL).compress(planes.tobytes())
    data = np.frombuffer(_HEAD.pack(height, width, step) + packed, np.uint8)
    return write_compressed(stamp_ns, frame_id, f"{encoding}; {CODEC}", data)


def expanded(data: NDArray[np.uint8], encoding: str) -> NDArray[Any]:
    """Return the image of a message's data.

    Its size is checked against the bounds of images before anything is unpacked, so that a few bytes cannot
    fill the memory.

    Raises:
        MessageRejectedError: the data are damaged, or say another size than they hold.
    """
    import zstandard  # noqa: PLC0415 - of an extra

    dtype, channels = pixel_format(encoding)
    if data.size < _HEAD.size:
        raise MessageRejectedError(Reason.MALFORMED, f"{CODEC} in {data.size} bytes has no head")
    height, width, step = _HEAD.unpack(data[: _HEAD.size].tobytes())
    within(IMAGE_SIDE, "width", width)
    within(IMAGE_SIDE, "height", height)
    within(IMAGE_PIXELS, "width x height", width * height)
    if step != width * channels * dtype.itemsize:
        raise MessageRejectedError(Reason.WRONG_SIZE, f"{width} {encoding} pixels a row in {step} bytes")
    packed, size = data[_HEAD.size :].tobytes(), height * step
    try:
        if zstandard.frame_content_size(packed) != size:
            raise MessageRejectedError(
                Reason.WRONG_SIZE, f"{CODEC} does not hold {height} rows of {step} bytes"
            )
        planes = zstandard.ZstdDecompressor().decompress(packed, max_output_size=size)
    except zstandard.ZstdError as error:
        raise MessageRejectedError(Reason.MALFORMED, f"{CODEC}: {error}") from error
    pixels = np.frombuffer(planes, np.uint8).reshape(dtype.itemsize, -1).T
    shape = (height, width) if channels == 1 else (height, width, channels)
    return np.ascontiguousarray(pixels).view(dtype).reshape(shape)
