"""Lenses of CameraInfo as the facility's one model: the rational polynomial, of which plumb_bob is a part.

A fisheye lens (equidistant, after J. Kannala, S. Brandt, IEEE PAMI 28(8), 2006) images the angle theta from
the boresight at the distance theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8). A rational
polynomial in the squared slope fits this within 1e-3 px up to 60 deg from the boresight, and within 0.1 px up
to 80 deg for focal lengths of 500 px. Pixels that see farther have to be cropped.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from rpod_schemas.bounds import DISTORTION
from rpod_schemas.errors import MessageRejectedError, Reason
from rpod_schemas.messages.header import within
from rpod_schemas.types import LENS_COEFFICIENTS

_MOST_RAD = np.radians(80.0)
"""Largest angle from the boresight that is fitted."""
_ANGLES = 400
_ROUNDS = 6
"""Rounds in which the fit's weights become those of distances in the image."""
_NUMBERS = {"": 5, "plumb_bob": 5, "rational_polynomial": LENS_COEFFICIENTS, "equidistant": 4, "fisheye": 4}
"""Number of coefficients by the distortion model."""


def coefficients(model: str, given: tuple[float, ...], farthest: float) -> NDArray[np.float64]:
    """Return the coefficients of plumb_bob, shape (5,), or of the rational polynomial, shape (8,).

    Args:
        model: distortion model of a CameraInfo.
        given: its coefficients; further ones must be 0.
        farthest: largest distance of a pixel from the principal point, over the focal length.

    Raises:
        MessageRejectedError: the model is unknown, or has terms that are not supported.
    """
    if model not in _NUMBERS:
        known = ", ".join(name for name in _NUMBERS if name)
        raise MessageRejectedError(Reason.WRONG_TYPE, f"distortion model {model!r}, known are {known}")
    number = _NUMBERS[model]
    within(DISTORTION, "distortion", np.array(given))
    if any(given[number:]):
        raise MessageRejectedError(
            Reason.WRONG_SIZE,
            f"{len(given)} distortion coefficients, {model or 'plumb_bob'} has {number}",
        )
    if number == 4:
        return _of_fisheye(tuple((*given, 0.0, 0.0, 0.0, 0.0)[:4]), farthest)
    padded = np.zeros(number)
    padded[: len(given)] = given[:number]
    return padded


@lru_cache(maxsize=16)
def _of_fisheye(k: tuple[float, ...], farthest: float) -> NDArray[np.float64]:
    """Return the rational polynomial that images like a fisheye lens, fitted by weighted least squares."""
    theta = np.linspace(0.0, _MOST_RAD, _ANGLES + 1)[1:]
    imaged = theta * (1.0 + sum(each * theta ** (2 * n + 2) for n, each in enumerate(k)))
    inside = int(np.argmax(imaged >= farthest)) + 1 if imaged.max() >= farthest else 0
    if not inside or (np.diff(imaged[:inside]) <= 0.0).any():
        raise MessageRejectedError(
            Reason.MALFORMED,
            f"the fisheye lens sees more than {np.degrees(_MOST_RAD):.0f} deg from its axis, or its "
            "coefficients fold the image; crop the image (roi), or correct the coefficients",
        )
    slope = np.tan(theta[: inside + 2])
    x, factor = slope**2, imaged[: inside + 2] / slope
    columns = np.stack([x, x**2, x**3, -factor * x, -factor * x**2, -factor * x**3], axis=1)
    weight, found = slope, np.zeros(6)
    for _ in range(_ROUNDS):
        scales = np.abs(columns * weight[:, None]).max(axis=0)
        found = np.linalg.lstsq(columns * weight[:, None] / scales, (factor - 1.0) * weight)[0] / scales
        weight = slope / np.abs(1.0 + x * (found[3] + x * (found[4] + x * found[5])))
    return np.array([found[0], found[1], 0.0, 0.0, *found[2:]])
