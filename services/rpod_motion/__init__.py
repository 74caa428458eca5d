"""Motion of chaser and target: the truth of a run at any time, in closed form or by integration."""

from rpod_motion.errors import MotionError
from rpod_motion.motion import MARGIN_S, Motion, MotionState, build_motion

__all__ = [
    "MARGIN_S",
    "Motion",
    "MotionError",
    "MotionState",
    "build_motion",
]
