"""Moves a coarse first pose to the likeliest one nearby, where the whole frame contradicts it."""

from collections.abc import Callable
from dataclasses import replace

from rpod_pose.belief import worst_sigma
from rpod_pose.pmd.joint.alternatives import MOST_DROP_LOG
from rpod_pose.pmd.joint.brightness.patch_renderer import PatchRenderer
from rpod_pose.pmd.joint.fit import JointProblem
from rpod_pose.pmd.joint.frame import JointFrame
from rpod_pose.pmd.joint.whole_image.climb import Whole, climbed
from rpod_pose.ports import Registration
from rpod_pose.registration.gauss_newton import State
from rpod_pose.registration.lie_group import PoseArrays
from rpod_schemas.poses import pose_of

COARSE = 0.02
"""Standard deviation of the position above which a pose is coarse, over the target's radius. Numerics: a
budget of computation; it is 1 % of the longest side of a long target."""


def is_coarse(found: Registration, radius_m: float) -> bool:
    """Return whether more computation may improve a pose."""
    return worst_sigma(found.covariance[:3, :3]) > COARSE * radius_m


def at_likeliest(
    found: Registration,
    seen: JointFrame,
    renderer: PatchRenderer,
    depth_at: Callable[[PoseArrays], JointProblem],
    radius_m: float,
) -> Registration:
    """Return a registration at the likeliest pose nearby, if the frame contradicts its own pose.

    The covariance remains: that of the likeliest pose would assume that the rendering is right to a fraction
    of a pixel. A smaller rise may be the effect of noise, or of what the rendering does not have.

    Args:
        found: registration with a pose.
        seen: the frame, around this pose.
        renderer: renders the target in this frame.
        depth_at: returns the points of the frame, with the planes that they show at a pose.
        radius_m: radius of the target.
    """
    assert found.T_sensor_target is not None  # noqa: S101 - the caller's condition
    if not seen.patch.typical:  # no amplitude
        return found
    px_m = seen.away_m / seen.lens.fx
    whole = Whole(seen.patch, seen.rays, seen.per_px, renderer.blur_px, renderer, depth_at, px_m, radius_m)
    start = State(PoseArrays.of(found.T_sensor_target), found.range_bias_m)
    (pose, bias_m), rise = climbed(whole, start)
    if rise <= MOST_DROP_LOG:
        return found
    return replace(found, T_sensor_target=pose_of(*pose), range_bias_m=bias_m)
