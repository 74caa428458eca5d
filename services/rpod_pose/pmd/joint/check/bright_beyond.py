"""Frames whose sky is as bright as the target: their amplitude contradicts every pose.

Behind the target may be a wall that the camera gives no ranges for. Each of its pixels is bright where no
surface of the target is. The depth alone may measure the pose.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

import numpy as np

from rpod_pose.belief import AMPLITUDE_LEFT_OUT, contradicted
from rpod_pose.pmd.joint.check.frame_check import BRIGHT, Contradictions
from rpod_pose.ports import Registration
from rpod_schemas.config.pmd.check import PmdCheckConfig
from rpod_schemas.types import PmdFrame

SPARSE = 4
"""Distance between the pixels that are looked at, along rows and columns. Numerics: a budget."""
_LEFT_OUT = (
    "its depth alone agrees with a pose: what has no range is as bright as the target; let the driver "
    "publish the ranges of what is behind the target, cover it, or leave the amplitude out of source.topics"
)
_Found = TypeVar("_Found")


def or_by_depth(
    measured: Callable[[PmdFrame], _Found], frame: PmdFrame, is_good: Callable[[_Found], bool]
) -> tuple[_Found, bool]:
    """Return what is measured in a frame, or by its depth alone if that is not good and the sky is bright.

    The second value says whether it was measured by the depth alone.
    """
    found = measured(frame)
    if is_good(found) or not is_bright_beyond(frame):
        return found, False
    again = measured(frame.model_copy(update={"amplitude": None, "saturated": None}))
    return (again, True) if is_good(again) else (found, False)


def marked(found: Registration) -> Registration:
    """Return a registration whose belief says that the amplitude was left out: it begins no track."""
    evidence = {**found.belief.evidence, AMPLITUDE_LEFT_OUT: 1.0}
    return replace(found, belief=replace(found.belief, evidence=evidence, insufficient=_LEFT_OUT))


def unsupported(found: Registration, missing: Contradictions, limits: PmdCheckConfig) -> Registration:
    """Return a registration by the depth alone, contradicted if too many ranges of its surface are missing.

    Args:
        found: the registration.
        missing: pixels on its surface that have no range although they are bright.
        limits: as for other inconsistent pixels.
    """
    if not (reason := missing.reason(limits)):
        return found
    reason = f"bright pixels on the target's surface have no range: {reason}; is it another body?"
    return replace(found, belief=contradicted(reason, **found.belief.evidence))


def is_bright_beyond(frame: PmdFrame) -> bool:
    """Return whether most pixels without a range are as bright as a surface of the target."""
    if frame.amplitude is None:
        return False
    every = (slice(None, None, SPARSE),) * 2
    measured, amplitude = frame.depth_m[every] > 0.0, frame.amplitude[every]
    if not measured.any() or measured.all():
        return False
    return bool(np.median(amplitude[~measured]) > BRIGHT[0] * np.median(amplitude[measured]))
