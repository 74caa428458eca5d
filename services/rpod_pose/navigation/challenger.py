"""Believed poses that the filter's gate refuses: evidence against the prediction.

Two of them in succession that agree with each other show that the target has been accelerated: the track is
continued at the second one. If they are farther from the prediction than an acceleration can explain, either
these poses or the track may be wrong. Then the track is lost after ``CONTESTED_S``.
"""

from dataclasses import dataclass, replace
from enum import Enum
from math import radians
from typing import NamedTuple

import numpy as np

from rpod_pose.navigation.filter import FilterState
from rpod_pose.navigation.history import History, apply
from rpod_pose.navigation.pose_measurement import PoseMeasurement
from rpod_schemas.config.estimator.filter import FilterConfig
from rpod_schemas.messages import NANOSECONDS
from rpod_schemas.poses import pose_error

EXPLAINED_DEG, EXPLAINED_M = 20.0, 0.5
"""Largest rotation and displacement from the prediction to a pose that an acceleration of the target can
explain. Physics: 60 deg/s2 and 3 m/s2 turn it by 7 deg and move it by 0.4 m in half a second, and attitudes
that are mistaken for each other are farther apart."""
CONTESTED_S = 0.2
"""Time after which a track is lost if believed poses agree on another attitude. Hand: nine frames of a camera
at 45 Hz; at a LIDAR's 1 Hz the second pose decides."""


@dataclass(frozen=True, eq=False)
class Challenger:
    """A track of poses that were believed but refused by the gate, and that agree with each other."""

    history: History
    since_ns: int
    """Stamp of the first of them."""


class Outcome(Enum):
    """What becomes of the track that is challenged."""

    OPEN = "the prediction goes on"
    REPLACED = "the track goes on at the challenger"
    LOST = "believed poses agree on another attitude than the tracked one"


class Challenge(NamedTuple):
    """The challenger after a pose, and what becomes of the track."""

    challenger: Challenger
    outcome: Outcome


def challenge(
    challenger: Challenger | None,
    *,
    predicted: FilterState,
    measured: PoseMeasurement,
    started: FilterState,
    config: FilterConfig,
) -> Challenge:
    """Return the challenger after a believed pose that the gate refused, and its outcome.

    Args:
        challenger: challenger of the earlier poses; None for the first pose.
        predicted: the track's prediction to the stamp of the pose.
        measured: the pose.
        started: a filter that starts at the pose, with an unknown twist.
        config: the filter's configuration.
    """
    applied = None if challenger is None else apply(challenger.history, measured, config)
    if challenger is None or applied is None or not applied.accepted:
        moving = replace(started, velocity_m_s=predicted.velocity_m_s, rate_rad_s=predicted.rate_rad_s)
        return Challenge(Challenger(History(moving), measured.stamp_ns), Outcome.OPEN)
    challenger = replace(challenger, history=applied.history)
    turn_rad, shift_m = (
        float(np.linalg.norm(part))
        for part in pose_error(predicted.T_chaser_target, measured.T_chaser_target)
    )
    if turn_rad <= radians(EXPLAINED_DEG) and shift_m <= EXPLAINED_M:
        return Challenge(challenger, Outcome.REPLACED)
    contested = (measured.stamp_ns - challenger.since_ns) / NANOSECONDS >= CONTESTED_S
    return Challenge(challenger, Outcome.LOST if contested else Outcome.OPEN)
