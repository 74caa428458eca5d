"""TOF_INFO of an ifm O3R: the head's lens and the times of its exposures.

Its layout from version 3 on is that of ifm3d's struct_tof_info_v4.hpp (at 0c9f0c3, Apache-2.0), its lens
models are those of o3r_uncompress_di.cpp (at 690a1f0). Model 0 turns a pixel into a direction; there the
centre of a pixel lies at half an integer, here at an integer. Model 1, the device's own inverse of it, is not
used: for the head of docs/examples/ifm/tof_info.data it differs from model 0 by up to 10 px.
"""

import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from rpod_driver.errors import DriverError
from rpod_schemas.types import Camera

_LEAST_VERSION, _LEAST_BYTES = 3, 416
_SCALES, _CALIBRATION, _STAMPS = struct.Struct("<I2f"), struct.Struct("<I32f"), struct.Struct("<3Q")
_INTRINSIC_AT, _STAMPS_AT = 0x30, 0x138
_BROWN = 0
"""Model of a lens that is understood; 2 is that of a fisheye lens."""
_RADII = 400
"""Number of distances from the principal point at which the lens is fitted."""


class TofInfoError(DriverError):
    """The structure TOF_INFO cannot be used."""


@dataclass(frozen=True)
class TofInfo:
    """Data about the head itself, which it sends in each frame."""

    version: int
    distance_resolution_m: float
    """Distance of one count, m."""
    amplitude_resolution: float
    """Amplitude of one squared count."""
    intrinsic: tuple[float, ...]
    """Model 0: fx, fy, cx, cy, skew, k1, k2, p1, p2, k3, from pixel to direction."""
    exposures_ns: tuple[int, ...]
    """Stamps of the frame's exposures by the device's clock, ns; those that were not used are left out."""

    def camera(self, width: int, height: int) -> Camera:
        """Return the lens for images of a size: the rational polynomial fitted to model 0.

        Raises:
            TofInfoError: no lens can be fitted to the terms.
        """
        fx, fy, cx, cy, *_ = self.intrinsic
        farthest = np.hypot(max(cx, width - cx) / fx, max(cy, height - cy) / fy)
        imaged = np.linspace(0.0, farthest, _RADII + 1)[1:]
        with np.errstate(over="ignore"):  # what is not finite is refused below
            slope = imaged * self._radial(imaged**2)

        def missed(k: NDArray[np.float64]) -> NDArray[np.float64]:
            above, below = (1.0 + slope**2 * np.polyval(half[::-1], slope**2) for half in (k[:3], k[3:]))
            return np.asarray(slope * above / below - imaged)

        try:
            with np.errstate(all="ignore"):
                k1, k2, k3, k4, k5, k6 = least_squares(missed, np.zeros(6), method="lm", x_scale="jac").x
            lens = np.array([k1, k2, 0.0, 0.0, k3, k4, k5, k6])
            return Camera(width=width, height=height, fx=fx, fy=fy, cx=cx - 0.5, cy=cy - 0.5, distortion=lens)
        except ValueError as error:  # terms with which no lens can be fitted, or a lens that is none
            raise TofInfoError(
                f"the lens cannot be used ({str(error).splitlines()[0]}); give it as device.calibration"
            ) from error

    def _radial(self, rr: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the slope of directions over the distance of their pixels, of squared distances."""
        k1, k2, k3 = self.intrinsic[5], self.intrinsic[6], self.intrinsic[9]
        return 1.0 + rr * (k1 + rr * (k2 + rr * k3))

    def cosines(self, width: int, height: int) -> NDArray[np.float64]:
        """Return z-depth over radial distance of each pixel by model 0, shape (height, width)."""
        fx, fy, cx, cy, *_ = self.intrinsic
        x, y = np.meshgrid((np.arange(width) + 0.5 - cx) / fx, (np.arange(height) + 0.5 - cy) / fy)
        rr = x * x + y * y
        cosines: NDArray[np.float64] = 1.0 / np.sqrt(1.0 + rr * self._radial(rr) ** 2)
        return cosines


def read_tof_info(data: bytes) -> TofInfo:
    """Return what the structure says.

    Raises:
        TofInfoError: its version or its lens model is not known; names it.
    """
    version = int.from_bytes(data[:4], "little")
    if version < _LEAST_VERSION or len(data) < _LEAST_BYTES:
        raise TofInfoError(
            f"TOF_INFO is of version {version} with {len(data)} bytes, ifm3d reads version {_LEAST_VERSION} "
            f"and later with at least {_LEAST_BYTES}; update the firmware of the device, or give the lens as "
            "device.calibration"
        )
    _, distance, amplitude = _SCALES.unpack_from(data)
    model, *intrinsic = _CALIBRATION.unpack_from(data, _INTRINSIC_AT)
    skew, p1, p2 = intrinsic[4], intrinsic[7], intrinsic[8]
    if model != _BROWN or any((skew, p1, p2)):
        raise TofInfoError(
            f"the lens has model {model}, skew {skew:g} and tangential terms {p1:g} and {p2:g}, known is "
            "model 0 without skew and tangential terms (2 is a fisheye lens); calibrate it, and give it as "
            "device.calibration"
        )
    if not np.isfinite(intrinsic[:10]).all() or min(intrinsic[:2]) <= 0.0:
        raise TofInfoError(
            f"the lens has fx {intrinsic[0]:g}, fy {intrinsic[1]:g} and terms that are not all finite; "
            "give it as device.calibration"
        )
    stamps = _STAMPS.unpack_from(data, _STAMPS_AT)
    exposures = tuple(stamp for stamp in stamps if stamp)
    return TofInfo(version, distance, amplitude, tuple(intrinsic[:10]), exposures)
