"""Error-state Kalman filter of pose, twist and further states, with measurements that may come late.

State: position p and attitude R of the target in chaser axes, v = dp/dt, and w with dR/dt = [w]x R. Error,
all in chaser axes: (dp, dtheta, dv, dw), estimate minus truth, dtheta = Log(R_est R^T). The pose block of
the covariance is published as it is (ICD section 1). After these twelve states there may be named blocks of
further states (``blocks``), whose errors are estimate minus truth too. Values are immutable, functions are
pure.

After an update by delta the attitude error is left-multiplied by J_l(delta). Source: J. Sola, Quaternion
kinematics for the error-state Kalman filter, arXiv:1711.02508, section 7 (errors in global axes), with J_l
in place of its first-order terms.

If every rotation about an axis of the target is a symmetry, the angle about this free axis is a convention.
No prediction and no update turns the target about it. Its variance is 0 inside the filter, and that of an
unknown angle in the published covariance. The rate about the axis is 0, with the variance of an unknown rate.
A sphere has three such axes: only its position is estimated.
"""

from rpod_pose.navigation.filter.blocks import UNSEEN, Block
from rpod_pose.navigation.filter.correction import (
    NOTHING,
    Innovation,
    Sensitivities,
    Update,
    gate_nis,
    gate_of,
    grown,
    innovation_of,
    is_consistent,
    separation_of,
    update,
)
from rpod_pose.navigation.filter.first_state import start
from rpod_pose.navigation.filter.odometry import to_odometry
from rpod_pose.navigation.filter.prediction import StampOrderError, predict, pushed
from rpod_pose.navigation.filter.priors import MOST_M_S2, velocity_sigma_m_s
from rpod_pose.navigation.filter.rotations import exponential, left_jacobian
from rpod_pose.navigation.filter.state import (
    ATTITUDE,
    CALM,
    NO_INNOVATIONS,
    POSE,
    POSITION,
    RATE,
    TWIST,
    VELOCITY,
    FilterState,
    InnovationSum,
    Manoeuvre,
    Motion,
    MotionModel,
    Other,
    Steady,
)

__all__ = [
    "ATTITUDE",
    "CALM",
    "MOST_M_S2",
    "NOTHING",
    "NO_INNOVATIONS",
    "POSE",
    "POSITION",
    "RATE",
    "TWIST",
    "UNSEEN",
    "VELOCITY",
    "Block",
    "FilterState",
    "Innovation",
    "InnovationSum",
    "Manoeuvre",
    "Motion",
    "MotionModel",
    "Other",
    "Sensitivities",
    "StampOrderError",
    "Steady",
    "Update",
    "exponential",
    "gate_nis",
    "gate_of",
    "grown",
    "innovation_of",
    "is_consistent",
    "left_jacobian",
    "predict",
    "pushed",
    "separation_of",
    "start",
    "to_odometry",
    "update",
    "velocity_sigma_m_s",
]
