"""Physical limits of the values in messages, each with its reason (ICD section 1, Bounds).

A value beyond its limits indicates a broken driver or a wrong unit, not a measurement. A result computed
from it may be infinite, or may need more memory than the machine has. The limits are wide: they include
every known sensor and rendezvous, with a margin. A test compares ``BOUNDS`` with the table of the ICD.
"""

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator

from rpod_schemas.arrays import FloatArray, Matrix6, VectorN

_SYMMETRIC = 1e-3
"""Largest asymmetry, and largest correlation beyond 1, of a covariance that has been rounded."""
_LARGEST = 1e300
"""Largest number that is printed in full: integers of JSON may be larger than any float."""


@dataclass(frozen=True)
class Bound:
    """The least and the greatest value that a quantity can have."""

    low: float
    high: float
    unit: str
    """Unit of the quantity; empty for a count or a ratio."""
    reason: str
    remedy: str = "check the unit"

    def __str__(self) -> str:
        unit = f" {self.unit}" if self.unit else ""
        return f"{_number(self.low)} to {_number(self.high)}{unit}"

    def check(self, value: Any) -> Any:
        """Return a number or an array, any shape, if all its values are within the limits.

        Raises:
            ValueError: a value is beyond; the text names the first one, the limits, their reason and the
                remedy.
        """
        if isinstance(value, np.ndarray):
            beyond = value[~((value >= self.low) & (value <= self.high))]
            if beyond.size:
                raise ValueError(self._text(float(beyond.flat[0])))
        elif not self.low <= value <= self.high:
            raise ValueError(self._text(value))
        return value

    def _text(self, value: float) -> str:
        what = _number(value) if abs(value) < np.inf else f"not finite ({value})"
        return f"is {what}, needs {self} ({self.reason}); {self.remedy}"


def _number(value: float) -> str:
    if abs(value) > _LARGEST:
        return "beyond 1e300"
    return f"{value:,.0f}" if abs(value) < 1e12 and float(value).is_integer() else f"{value:.6g}"


STAMP_NS = Bound(0, 2**31 * 1_000_000_000 - 1, "ns", "builtin_interfaces/Time has 31 bits of seconds")
TEXT = Bound(0, 65_536, "characters", "names and reasons are read by people")
IMAGE_SIDE = Bound(1, 8_192, "px", "no time-of-flight imager has 2,000 pixels a side", "check the driver")
IMAGE_PIXELS = Bound(
    1, 2**24, "px", "16 million pixels, twelve times the largest such imager", "bin or crop it"
)
DEPTH_M = Bound(
    -1e5,
    1e5,
    "m",
    "no light comes back from farther",
    "send metres, and NaN or infinity for pixels without depth",
)
AMPLITUDE = Bound(-(2.0**32), 2.0**32, "", "converters have at most 32 bits", "send NaN for missing values")
FOCAL_LENGTH_PX = Bound(0.01, 1e6, "px", "a pixel sees more than 1 microradian", "calibrate the camera")
PRINCIPAL_POINT_PX = Bound(-16_384, 16_384, "px", "it is on the sensor of which the image is a part")
DISTORTION = Bound(-1e4, 1e4, "", "fits of narrow lenses reach some hundreds", "calibrate the camera")
MODULATION_FREQUENCY_HZ = Bound(1e5, 1e9, "Hz", "the unambiguous range c / 2f is 0.15 m to 1.5 km")
FREQUENCIES = Bound(0, 8, "", "cameras have one to four modulation frequencies", "check the driver")
INTEGRATION_TIME_S = Bound(1e-7, 10.0, "s", "two periods of 20 MHz to a long exposure in the dark")
ELECTRONS_PER_COUNT = Bound(1e-4, 1e7, "e-/count", "a pixel holds at most some million electrons")
SATURATION_COUNT = Bound(1, 2**32, "counts", "no converter has more than 32 bits")
DIRECTIONS = Bound(0, 65_536, "", "rows or columns of a scan", "check the driver")
SCAN_DIRECTIONS = Bound(
    0, 2**22, "", "60 deg x 60 deg every 0.03 deg, seconds of a million pulses each", "send fewer directions"
)
AZIMUTH_RAD = Bound(-2.0 * np.pi, 2.0 * np.pi, "rad", "one turn either way", "are they degrees?")
ELEVATION_RAD = Bound(
    -np.pi / 2.0,
    np.pi / 2.0,
    "rad",
    "from straight up to straight down: elevation counts downwards",
    "are they degrees?",
)
ANGLE_STEP_RAD = Bound(1e-6, 2.0 * np.pi, "rad", "no beam is narrower", "list each direction once")
SCAN_TIME_S = Bound(0, 600, "s", "a target moves too much in a longer scan")
RETURN_TIME_S = Bound(-600, 600, "s", "a return belongs to its scan", "send seconds from the stamp")
SIGMA_RANGE_M = Bound(0, 100, "m", "beyond it no pose is measured at the ranges of a rendezvous")
POSITION_M = Bound(-1e9, 1e9, "m", "twice the way to the Moon")
MOUNT_M = Bound(0, 200, "m", "no spacecraft is longer", "check the transform on tf_static")
SPEED_M_S = Bound(-1e5, 1e5, "m/s", "three times a comet's speed at Earth")
RATE_RAD_S = Bound(-1e4, 1e4, "rad/s", "about the rate of the fastest rotors")
ACCELERATION_M_S2 = Bound(-1e4, 1e4, "m/s2", "a thousand times the weight on Earth")
COMMAND_M_S2 = Bound(
    -20.0, 20.0, "m/s2", "twice the weight on Earth: no chaser near a target thrusts harder", "send m/s2"
)
COMMAND_VARIANCE = Bound(0, 400.0, "(m/s2)^2", "the square of the largest command", "send a variance")
VARIANCE = Bound(0, 1e18, "", "the square of the farthest position")
IRRADIANCE_W_M2 = Bound(0, 1e5, "W/m2", "seventy times the Sun at Earth")
HYPOTHESES = Bound(0, 1_000, "", "more hypotheses are not a useful result", "send the best")
SHARE = Bound(0, 1.000001, "", "a share of a whole")

BOUNDS: dict[str, Bound] = {
    "every stamp": STAMP_NS,
    "every text": TEXT,
    "Image, CameraInfo: width, height": IMAGE_SIDE,
    "Image, CameraInfo: width x height": IMAGE_PIXELS,
    "depth image: each pixel, where finite": DEPTH_M,
    "amplitude image: each pixel, where not NaN": AMPLITUDE,
    "CameraInfo: fx, fy": FOCAL_LENGTH_PX,
    "CameraInfo: cx, cy": PRINCIPAL_POINT_PX,
    "CameraInfo: each of D": DISTORTION,
    "PmdInfo: number of modulation_frequency_hz": FREQUENCIES,
    "PmdInfo: modulation_frequency_hz": MODULATION_FREQUENCY_HZ,
    "PmdInfo: integration_time_s": INTEGRATION_TIME_S,
    "PmdInfo: electrons_per_count": ELECTRONS_PER_COUNT,
    "PmdInfo: saturation_count": SATURATION_COUNT,
    "LidarInfo: number of azimuth_rad, of elevation_rad": DIRECTIONS,
    "LidarInfo: number of azimuth_rad x elevation_rad; PointCloud2: points": SCAN_DIRECTIONS,
    "LidarInfo: azimuth_rad": AZIMUTH_RAD,
    "LidarInfo: elevation_rad": ELEVATION_RAD,
    "LidarInfo: between two of azimuth_rad, of elevation_rad": ANGLE_STEP_RAD,
    "LidarInfo: scan_time_s": SCAN_TIME_S,
    "LidarInfo: sigma_range_m": SIGMA_RANGE_M,
    "PointCloud2: t": RETURN_TIME_S,
    "poses and transforms: x, y, z": POSITION_M,
    "tf_static: distance of a sensor from the chaser's origin": MOUNT_M,
    "Odometry: linear velocity, each axis": SPEED_M_S,
    "Odometry: angular velocity, each axis": RATE_RAD_S,
    "Odometry: variances, in their SI units": VARIANCE,
    "Imu: angular velocity, each axis": RATE_RAD_S,
    "Imu: linear acceleration, each axis": ACCELERATION_M_S2,
    "guidance/command: linear acceleration, each axis": COMMAND_M_S2,
    "guidance/command: variances, (m/s2)^2": COMMAND_VARIANCE,
    "environment/sun: irradiance": IRRADIANCE_W_M2,
    "EstimatorStatus: number of hypotheses": HYPOTHESES,
    "EstimatorStatus: inlier_share, each weight, their sum": SHARE,
}
"""Limits by the fields to which they apply, named as in the ICD."""


def bounded(bound: Bound) -> Any:
    """Return the pydantic validator of a limit."""
    return AfterValidator(bound.check)


def check_covariance(covariance: FloatArray) -> FloatArray:
    """Return a covariance, shape (6, 6): symmetric, no variance negative, no correlation beyond 1.

    Raises:
        ValueError: the matrix is not a covariance; the text names what is wrong.
    """
    if not covariance.any():
        return covariance
    variance = covariance.diagonal()
    if not ((variance >= VARIANCE.low) & (variance <= VARIANCE.high)).all():
        VARIANCE.check(variance)
    sigma = np.sqrt(variance)
    most = (1.0 + _SYMMETRIC) * np.outer(sigma, sigma) + np.finfo(float).tiny
    if (np.abs(covariance) > most).any():
        raise ValueError("has a correlation beyond 1, needs a covariance; check the order of its axes")
    if (np.abs(covariance - covariance.T) > _SYMMETRIC * most).any():
        raise ValueError("is not symmetric, needs a covariance; check the order of its elements")
    return covariance


def _short(text: str) -> str:
    TEXT.check(len(text))
    return text


def _pattern(bound: Bound) -> Any:
    def check(angles_rad: FloatArray) -> FloatArray:
        DIRECTIONS.check(angles_rad.size)
        bound.check(angles_rad)
        if angles_rad.size > 1:
            try:
                ANGLE_STEP_RAD.check(float(np.diff(np.sort(angles_rad)).min()))
            except ValueError as error:
                raise ValueError(f"the least step between two directions {error}") from error
        return angles_rad

    return AfterValidator(check)


Stamp = Annotated[int, bounded(STAMP_NS)]
"""Nanoseconds of UTC since the Unix epoch."""
Text = Annotated[str, AfterValidator(_short)]
"""A name or a sentence; an error states its length."""
Covariance6 = Annotated[Matrix6, AfterValidator(check_covariance)]
"""A covariance, shape (6, 6), symmetric, with positive variances."""
AzimuthsRad = Annotated[VectorN, _pattern(AZIMUTH_RAD)]
"""Azimuths of a scan pattern's columns, shape (N,)."""
ElevationsRad = Annotated[VectorN, _pattern(ELEVATION_RAD)]
"""Elevations of a scan pattern's rows, shape (N,)."""
