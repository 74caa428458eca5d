"""Moves chaser and target: the truth of a run, from a closed form or an integration, at any time."""

from rpod_motion.errors import MotionError
from rpod_motion.motion import MARGIN_S, Motion, MotionState, build_motion
from rpod_motion.safety_ellipse import safety_ellipse_positions

__all__ = [
    "MARGIN_S",
    "Motion",
    "MotionError",
    "MotionState",
    "build_motion",
    "safety_ellipse_positions",
]
