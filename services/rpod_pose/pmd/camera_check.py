"""Whether frames are of the camera that they should be of: size, intrinsics and distortion.

A wrong principal point moves the target, a wrong focal length scales it; one image hardly tells either from
a target that is elsewhere. So frames are compared with what is configured, and with the frames before.
"""

from collections import Counter

import numpy as np

from rpod_schemas.arrays import FloatArray
from rpod_schemas.errors import MessageRejectedError, Reason
from rpod_schemas.types import Camera

_ALIKE = 1e-3
"""Relative difference of two focal lengths that are the same, and difference of two distortions."""
_ALIKE_PX = 0.5
"""Difference of two principal points that are the same."""
_PATIENCE = 10
"""Frames of another camera in a row after which the camera has changed."""


class CameraWatch:
    """The camera of each sensor, as its frames tell."""

    def __init__(self) -> None:
        self._known: dict[str, Camera] = {}
        self._others: Counter[str] = Counter()

    def check(self, sensor: str, camera: Camera) -> None:
        """Accept a frame's camera: the first, the same again, or another that stays.

        Raises:
            MessageRejectedError: it is none of the three; the text names what differs.
        """
        why = difference(camera, self._known.setdefault(sensor, camera))
        if not why:
            self._others[sensor] = 0
            return
        self._others[sensor] += 1
        if self._others[sensor] <= _PATIENCE:
            raise MessageRejectedError(Reason.OTHER_CAMERA, f"{why} in the frames before")
        self._known[sensor] = camera
        self._others[sensor] = 0


def difference(camera: Camera, expected: Camera) -> str:
    """Return the first field in which two cameras differ, with both values; empty where they are the same."""
    for name in ("width", "height", "fx", "fy", "cx", "cy"):
        have, want = getattr(camera, name), getattr(expected, name)
        tolerance = _ALIKE * want if name in ("fx", "fy") else _ALIKE_PX
        if abs(have - want) > tolerance:
            return f"{name} is {have:g}, not {want:g} as"
    have, want = camera.distortion, expected.distortion
    same_lens = have.shape == want.shape and np.allclose(have, want, rtol=0.0, atol=_ALIKE)
    return "" if same_lens else f"distortion is {_list(have)}, not {_list(want)} as"


def _list(numbers: FloatArray) -> str:
    return ", ".join(f"{number:g}" for number in numbers) or "none"
