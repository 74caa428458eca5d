"""Check that frames come from the expected camera: size, intrinsics and distortion.

A wrong principal point shifts the target, and a wrong focal length scales it. In one image both look almost
like a target at another place. Therefore the camera of each frame is compared with the configuration and with
earlier frames.
"""

from collections import Counter

import numpy as np

from rpod_schemas.arrays import FloatArray
from rpod_schemas.errors import MessageRejectedError, Reason
from rpod_schemas.types import Camera

_SAME = 1e-3
"""Largest relative difference of focal lengths, and largest difference of distortion coefficients, that count
as equal. Hand: drivers round intrinsics; those of a changed lens or mode differ by some percent."""
_SAME_PX = 0.5
"""Largest difference of principal points that count as equal, px. Hand: two conventions for the centre of a
pixel differ by as much."""
_PATIENCE = 10
"""Number of consecutive frames of another camera after which the camera counts as changed. Hand: a quarter of
a second at 45 Hz; one foreign frame changes nothing."""


class CameraCheck:
    """Remembers the camera of each sensor and rejects frames of another one."""

    def __init__(self) -> None:
        self._known: dict[str, Camera] = {}
        self._others: Counter[str] = Counter()

    def check(self, sensor: str, camera: Camera, *, pinned: bool = False) -> None:
        """Accept the camera of a frame, or refuse it by an error.

        Accepted are the first camera of a sensor, the known one, and another one that was sent in more than
        ten frames in succession.

        Args:
            sensor: name of the sensor.
            camera: camera of the frame.
            pinned: whether a track uses the known camera; then no other one is accepted.

        Raises:
            MessageRejectedError: the camera is none of these; the text names the field and both values.
        """
        why = difference(camera, self._known.setdefault(sensor, camera))
        if not why:
            self._others[sensor] = 0
            return
        self._others[sensor] += not pinned
        if pinned or self._others[sensor] <= _PATIENCE:
            remedy = (
                "`reset` the estimator if the new one is right"
                if pinned
                else f"it is used after {_PATIENCE} such frames in a row; let one driver alone publish it"
            )
            raise MessageRejectedError(Reason.OTHER_CAMERA, f"{why} in the frames before; {remedy}")
        self._known[sensor] = camera
        self._others[sensor] = 0


def difference(camera: Camera, expected: Camera) -> str:
    """Return the first field in which two cameras differ, with both values; empty if they are equal."""
    for name in ("width", "height", "fx", "fy", "cx", "cy"):
        have, want = getattr(camera, name), getattr(expected, name)
        tolerance = _SAME * want if name in ("fx", "fy") else _SAME_PX
        if abs(have - want) > tolerance:
            return f"{name} is {have:g}, not {want:g} as"
    if np.allclose(camera.coefficients, expected.coefficients, rtol=0.0, atol=_SAME):
        return ""
    return f"distortion is {_list(camera.distortion)}, not {_list(expected.distortion)} as"


def _list(numbers: FloatArray) -> str:
    return ", ".join(f"{number:g}" for number in numbers) or "none"
