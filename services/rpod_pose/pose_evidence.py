"""Data that a method may return beside a pose: its errors by how long they last, and tests of the model."""

from dataclasses import dataclass
from math import inf
from typing import Self

import numpy as np

from rpod_schemas.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class ErrorParts:
    """Errors of a measured pose, separated by how long they last.

    They follow from the frame, the calibration and the target's file. Each covariance is that of
    (dp, dtheta), sensor's fixed axes, shape (6, 6). Their sum may differ from the registration's covariance,
    which also contains assumptions about errors that nobody has declared.
    """

    white: FloatArray
    """Errors caused by the noise of the frame; they are independent in each frame."""
    of_sensor: FloatArray
    """Errors of the sensor's calibration; they are constant in the sensor's axes."""
    of_image: FloatArray
    """Errors that depend on where surfaces and edges lie relative to the pixels. They last until the image
    has moved by a part of a pixel."""
    image_turn_rad: float
    """Rotation of the target relative to the line of sight after which the correlation of ``of_image`` is
    1/e."""
    of_model: FloatArray
    """Errors of the target's model, and of its brightness as rendered; they are constant in the target's axes
    while the same parts are seen."""

    @classmethod
    def lasting_model(cls, white: FloatArray, of_model: FloatArray) -> Self:
        """Return the parts of a pose whose only lasting errors are those of the target's model.

        A LIDAR scan is an example: in the next scan each ray meets another place of the surface, so that the
        errors caused by sampling are independent.
        """
        return cls(white, np.zeros((6, 6)), np.zeros((6, 6)), np.inf, of_model)


@dataclass(frozen=True)
class Misfit:
    """A test value of one frame that is large only if the target's model or the pose is wrong.

    If both are right, its mean is at most 0, and the values of different frames are independent.
    """

    value: float
    variance: float
    """Variance of the value if model and pose are right."""
    noise: float = 1.0
    """Noise of the data over the assumed one; 1 where the residuals show no other noise."""


@dataclass(frozen=True, eq=False)
class OtherSize:
    """The pose of a frame under the hypothesis that the target is larger or smaller than its model."""

    share: float
    """Relative enlargement of the target about its origin; negative if it is smaller."""
    log_odds: float
    """Log likelihood of the frame with this size minus that with the model's own size."""
    step: FloatArray
    """Step (dtau, dtheta) from the registration's pose to the one with this size, target axes, shape (6,)."""
    most_log_odds: float = inf
    """Upper limit of the log odds of all frames together: larger odds may also be caused by an error that
    all frames share."""
    tests: bool = True
    """Whether frames that prefer this size show that the model's own is wrong. If not, the sizes are so near
    that the likelihood of a right model may prefer it too."""


@dataclass(frozen=True, eq=False)
class PartSolution:
    """The position measured by one part of a frame's data, which may be wrong while the rest is right."""

    name: str
    """Name of this part of the data."""
    offset_m: FloatArray
    """Vector from the registration's position to this position, sensor axes, shape (3,), m."""
    sigma_m: float
    """Standard deviation of the lasting error of this part along the offset, m."""
    apart_m: float
    """Standard deviation of the offset if all data are right, m: the registration has used this part too."""
    follows: float = 1.0
    """Share of an error of the rest of the data that the offset shows; the registration follows the part by
    what is left."""
