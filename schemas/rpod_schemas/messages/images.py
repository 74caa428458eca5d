"""Images, and intrinsics of the camera that made them."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rpod_schemas.bounds import AMPLITUDE, DEPTH_M, IMAGE_PIXELS, IMAGE_SIDE
from rpod_schemas.errors import MessageRejectedError, Reason
from rpod_schemas.messages.header import build, within, write_header
from rpod_schemas.messages.lenses import coefficients
from rpod_schemas.rmw.cdr import message_class
from rpod_schemas.types import Camera

_NO_PIXEL = (
    "no finite pixel in the depth image; check the sensor's cover, lamp, exposure and range, if the target "
    "is in view"
)
_AMPLITUDES = "mono16, mono8 or 32FC1; a colour image is not an amplitude: leave it out of source.topics"
_CALIBRATE = "give its driver a calibration ('rpod calibrate camera' makes one)"
_ENCODINGS: dict[str, tuple[str, int]] = {
    "32FC1": ("<f4", 1),
    "16UC1": ("<u2", 1),
    "mono16": ("<u2", 1),
    "mono8": ("u1", 1),
    "16UC4": ("<u2", 4),
}


def pixel_format(encoding: str) -> tuple[np.dtype[Any], int]:
    """Return data type, little-endian, and channels of an encoding. Raises ``MessageRejectedError``."""
    if encoding not in _ENCODINGS:
        known = ", ".join(_ENCODINGS)
        text = f"encoding {encoding!r}, known are {known}; let the driver publish one of them"
        raise MessageRejectedError(Reason.WRONG_TYPE, text)
    code, channels = _ENCODINGS[encoding]
    return np.dtype(code), channels


def read_image(message: Any) -> NDArray[Any]:
    """Return the pixels of a sensor_msgs/Image as a view, (height, width) or (height, width, channels)."""
    dtype, channels = pixel_format(message.encoding)
    if message.is_bigendian and dtype.itemsize > 1:
        dtype = dtype.newbyteorder(">")
    row = message.width * channels * dtype.itemsize
    if wrong := _wrong_size(message, row):
        text = f"{message.width} x {message.height} pixels of {message.encoding}: {wrong}; correct the driver"
        raise MessageRejectedError(Reason.WRONG_SIZE, text)
    within(IMAGE_SIDE, "width", message.width)
    within(IMAGE_SIDE, "height", message.height)
    within(IMAGE_PIXELS, "width x height", message.width * message.height)
    shape = (message.height, message.width) if channels == 1 else (message.height, message.width, channels)
    strides = (message.step, channels * dtype.itemsize, dtype.itemsize)[: len(shape)]
    return np.ndarray(shape, dtype, buffer=message.data, strides=strides)


def _wrong_size(message: Any, row: int) -> str:
    """Return what is wrong with an image's sizes; a row of pixels has ``row`` bytes. Empty if nothing is."""
    if 0 in (message.width, message.height):
        return "there are none"
    if message.step < row:
        return f"step is {message.step} bytes, a row needs {row}"
    needed = message.step * message.height
    return (
        ""
        if message.data.size == needed
        else f"data has {message.data.size} bytes, step x height is {needed}"
    )


_LARGEST = 65535
"""Largest value of a pixel of 16 bits."""


def is_measured(counts: NDArray[Any]) -> NDArray[np.bool_]:
    """Return which pixels of a depth image of 16 bits hold a depth: 0 and 65535 mean that there is none."""
    measured: NDArray[np.bool_] = (counts > 0) & (counts < _LARGEST)
    return measured


def read_depth(message: Any, unit_m: float | None = None) -> NDArray[np.float32]:
    """Return the depth, m, shape (height, width), of an image.

    Pixels without depth become NaN: those of 0, and those of 65535, by which drivers mark a missing return,
    or one that is too far for the image.

    Args:
        message: a sensor_msgs/Image, ``32FC1`` in metres, or ``16UC1`` or ``mono16`` in millimetres.
        unit_m: length of the driver's unit, if it is another one.

    Raises:
        MessageRejectedError: the image has another encoding, or no finite pixel, or a pixel is too far.
    """
    image = read_image(message)
    if message.encoding in ("16UC1", "mono16"):
        image = np.where(
            is_measured(image), image.astype(np.float32) * np.float32(unit_m or 1e-3), np.float32(np.nan)
        )
    elif message.encoding != "32FC1":
        raise MessageRejectedError(Reason.WRONG_TYPE, f"depth in {message.encoding}, needs 32FC1 or 16UC1")
    elif unit_m is not None:
        image = image * np.float32(unit_m)
    known = np.abs(image) <= DEPTH_M.high  # NaN is not
    if not known.all():
        within(DEPTH_M, "a pixel of the depth image", image[~known & np.isfinite(image)])
        if not known.any():
            raise MessageRejectedError(Reason.NOT_FINITE, _NO_PIXEL)
    return image.astype(np.float32, copy=False)


def read_amplitude(message: Any) -> NDArray[Any]:
    """Return the amplitude, shape (height, width), of a ``mono16``, ``mono8`` or ``32FC1`` image.

    NaN, which cameras send where they measure nothing, becomes 0.
    """
    if message.encoding not in ("mono16", "mono8", "32FC1", "16UC1"):
        raise MessageRejectedError(Reason.WRONG_TYPE, f"amplitude in {message.encoding}, needs {_AMPLITUDES}")
    image = read_image(message)
    if image.dtype.kind == "f" and not (np.abs(image) <= AMPLITUDE.high).all():
        within(AMPLITUDE, "a pixel of the amplitude image", image[~np.isnan(image)])
        image = np.nan_to_num(image, nan=0.0)
    return image.astype(image.dtype.newbyteorder("="), copy=False)


def write_image(stamp_ns: int, frame_id: str, image: NDArray[Any], encoding: str) -> Any:
    """Return a sensor_msgs/Image of pixels, (height, width) or (height, width, channels).

    They are not copied if they are C-contiguous.
    """
    return message_class("sensor_msgs/msg/Image")(
        header=write_header(stamp_ns, frame_id),
        height=image.shape[0],
        width=image.shape[1],
        encoding=encoding,
        is_bigendian=0,
        step=image[0].nbytes,
        data=np.ascontiguousarray(image).reshape(-1).view(np.uint8),
    )


def write_compressed(stamp_ns: int, frame_id: str, form: str, data: NDArray[np.uint8]) -> Any:
    """Return a sensor_msgs/CompressedImage of a codec's bytes, shape (N,)."""
    return message_class("sensor_msgs/msg/CompressedImage")(
        header=write_header(stamp_ns, frame_id), format=form, data=data
    )


def read_camera(message: Any) -> Camera:
    """Return the camera of a sensor_msgs/CameraInfo for the images as they are sent, binned and cropped.

    Distortion models are plumb_bob, rational_polynomial and equidistant, or none. The size and the camera
    matrix of the message are those of the full resolution; a region of interest is cut out of it, then
    ``binning`` x ``binning`` pixels make one.
    """
    K = message.k
    if not np.isfinite(K).all():
        raise MessageRejectedError(Reason.NOT_FINITE, f"camera matrix {np.asarray(K).tolist()}; {_CALIBRATE}")
    if not np.any(K):
        raise MessageRejectedError(
            Reason.MALFORMED, f"the camera matrix is all 0: the camera is not calibrated; {_CALIBRATE}"
        )
    if np.any(np.asarray(K)[[1, 3, 6, 7, 8]] != (0.0, 0.0, 0.0, 0.0, 1.0)):
        raise MessageRejectedError(
            Reason.MALFORMED,
            f"camera matrix {np.asarray(K).tolist()}, needs fx, 0, cx, 0, fy, cy, 0, 0, 1; "
            "correct the driver",
        )
    within(IMAGE_SIDE, "width", message.width)
    within(IMAGE_SIDE, "height", message.height)
    region, by_x, by_y = message.roi, max(message.binning_x, 1), max(message.binning_y, 1)
    width, height = (region.width or message.width) // by_x, (region.height or message.height) // by_y
    camera = build(
        Camera,
        width=width,
        height=height,
        fx=K[0] / by_x,
        fy=K[4] / by_y,
        cx=(K[2] - region.x_offset - (by_x - 1) / 2.0) / by_x,
        cy=(K[5] - region.y_offset - (by_y - 1) / 2.0) / by_y,
    )
    across, down = max(camera.cx, width - camera.cx), max(camera.cy, height - camera.cy)
    farthest = float(np.hypot(across / camera.fx, down / camera.fy))
    lens = coefficients(message.distortion_model, tuple(map(float, message.d)), farthest)
    return build(Camera, **dict(camera) | {"distortion": lens})


def write_camera(stamp_ns: int, frame_id: str, camera: Camera) -> Any:
    """Return a sensor_msgs/CameraInfo."""
    projection = np.hstack([camera.K, np.zeros((3, 1))])
    roi = message_class("sensor_msgs/msg/RegionOfInterest")(
        x_offset=0, y_offset=0, height=0, width=0, do_rectify=False
    )
    return message_class("sensor_msgs/msg/CameraInfo")(
        header=write_header(stamp_ns, frame_id),
        height=camera.height,
        width=camera.width,
        distortion_model="plumb_bob" if camera.distortion.size <= 5 else "rational_polynomial",
        d=camera.distortion,
        k=camera.K.ravel(),
        r=np.eye(3).ravel(),
        p=projection.ravel(),
        binning_x=0,
        binning_y=0,
        roi=roi,
    )
