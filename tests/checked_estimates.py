"""What an estimator publishes that follows a second sensor, for the check of the first."""

import numpy as np
from checked_sensors import EPOCH_NS, SECOND_NS, odometry_of, tumbling
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_schemas.poses import chained, make_pose
from rpod_schemas.types import EstimatorStatus, Mode, Odometry


def estimates_of(
    sensor: str, *, rate_hz: float, seed: int, off: RigidTransform | None = None
) -> list[tuple[Odometry, EstimatorStatus]]:
    """Return what an estimator publishes that follows the tumbling target with a sensor.

    Args:
        sensor: name of this sensor.
        rate_hz: rate of its frames.
        seed: seed of the poses' errors, 3 mm and 0.2 deg on each axis, as the estimator states them.
        off: by what the mount of this sensor is off, in chaser axes; None for nothing.
    """
    random = np.random.default_rng([seed, 0xE57])
    sigma = np.repeat([3e-3, np.deg2rad(0.2)], 3)
    published = []
    for number in range(round(17.0 * rate_hz)):
        time_s = 0.9 + number / rate_hz
        wrong = sigma * random.standard_normal(6)
        pose = chained(make_pose() if off is None else off, tumbling(time_s))
        moved = make_pose(
            translation_m=pose.translation + wrong[:3],
            rotation=Rotation.from_rotvec(wrong[3:]) * pose.rotation,
        )
        odometry = odometry_of(EPOCH_NS + round(time_s * SECOND_NS), moved)
        status = EstimatorStatus(
            stamp_ns=odometry.stamp_ns, frame_id="chaser", mode=Mode.TRACKING, sensor=sensor, accepted=True
        )
        published.append((odometry.model_copy(update={"pose_covariance": np.diag(sigma**2)}), status))
    return published
