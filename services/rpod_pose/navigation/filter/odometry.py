"""The filter's state as the message that is published."""

import numpy as np

from rpod_pose.navigation.filter.rotations import cross_matrix, symmetric
from rpod_pose.navigation.filter.state import ATTITUDE, POSE, RATE, VELOCITY, FilterState
from rpod_schemas.poses import rotation_matrix
from rpod_schemas.types import Odometry
from rpod_target.equivalence import FREE_SIGMA_RAD


def to_odometry(state: FilterState, *, frame_id: str, child_frame_id: str) -> Odometry:
    """Return the state as an odometry message: twist and its covariance in child axes.

    With v_child = R^T v the error is R^T (dv + v x dtheta) to first order, and likewise for the rate, so
    the twist's covariance includes its correlation with the attitude error. Velocity and rate are relative to
    the chaser: an error do of its rate moves them by p x do and -do. The angle about a free axis has the
    variance of an unknown angle; the twist is given in the axes that the published attitude has.
    """
    R = rotation_matrix(state.T_chaser_target)
    R_target_chaser = R.T
    jacobian = np.zeros((6, state.size))
    jacobian[0:3, ATTITUDE] = R_target_chaser @ cross_matrix(state.velocity_m_s)
    jacobian[3:6, ATTITUDE] = R_target_chaser @ cross_matrix(state.rate_rad_s)
    jacobian[0:3, VELOCITY] = jacobian[3:6, RATE] = R_target_chaser
    place = cross_matrix(state.T_chaser_target.translation)
    by_chaser = np.vstack([R_target_chaser @ place, -R_target_chaser])
    return Odometry(
        stamp_ns=state.stamp_ns,
        frame_id=frame_id,
        child_frame_id=child_frame_id,
        pose=state.T_chaser_target,
        linear_m_s=R_target_chaser @ state.velocity_m_s,
        angular_rad_s=R_target_chaser @ state.rate_rad_s,
        pose_covariance=state.alike.with_free_variance(
            state.covariance[POSE, POSE].copy(), R, FREE_SIGMA_RAD**2
        ),
        twist_covariance=symmetric(
            jacobian @ state.covariance @ jacobian.T + state.chaser_rate_variance * by_chaser @ by_chaser.T
        ),
    )
