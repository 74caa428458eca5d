"""Images in a codec's bytes (sensor_msgs/CompressedImage) as plain ones, by OpenCV.

The topics of image_transport end in ``/compressed`` (PNG or JPEG) and ``/compressedDepth`` (a header of 12
bytes, then PNG). Only 16UC1 keeps its values in ``compressedDepth``; 32FC1 is quantised by inverse depth.
"""

from typing import Any

import numpy as np

from rpod_schemas.errors import MessageRejectedError, Reason
from rpod_schemas.messages import read_stamp, write_image

_DEPTH_HEADER_BYTES = 12
"""Size of compressed_depth_image_transport's ConfigHeader."""
_ENCODINGS = {"uint8": "mono8", "uint16": "mono16"}


def decompressed(message: Any) -> Any:
    """Return the sensor_msgs/Image of a sensor_msgs/CompressedImage.

    Raises:
        MessageRejectedError: the codec loses depth, is not supported, or its bytes are damaged.
    """
    import cv2  # noqa: PLC0415 - only who reads compressed images needs it

    encoding, _, codec = (part.strip() for part in message.format.partition(";"))
    data = np.asarray(message.data, np.uint8)
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
    image = cv2.imdecode(data, cv2.IMREAD_UNCHANGED) if data.size else None
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
