"""Surroundings of a trial: a laboratory around the target, or a plate that hides a half of it."""

from typing import Literal

from rpod_schemas.config.surroundings import BoxThing, CylinderThing, Thing
from rpod_schemas.poses import make_pose
from rpod_target import Target

SurroundingsName = Literal["none", "arm", "laboratory", "occluded"]
"""Name of the surroundings of a trial. arm: the end of an arm that holds the target from behind, and nothing
else; laboratory: a room, a stand beside the target, and such an arm; occluded: a room, and a plate before the
left half of the field of view."""


def surroundings(name: SurroundingsName, target: Target, range_m: tuple[float, float]) -> tuple[Thing, ...]:
    """Return the things around a target between two ranges on the boresight, sized in its radii."""
    radius_m, (near_m, far_m) = target.radius_m, range_m
    if name == "none":
        return ()
    if name == "arm":
        return (_arm(target, radius_m),)
    depth_m = far_m + 2.5 * radius_m
    room = BoxThing(
        kind="box",
        size_m=(5.0 * radius_m, 4.0 * radius_m, depth_m),
        pose=make_pose(translation_m=(0.0, 0.0, 0.5 * depth_m - radius_m)),
    )
    if name == "occluded":
        return (room, _plate(0.5 * near_m, radius_m))
    stand = BoxThing(
        kind="box",
        size_m=(0.3 * radius_m, 4.0 * radius_m, 0.3 * radius_m),
        pose=make_pose(translation_m=(-1.6 * radius_m, 1.0 * radius_m, far_m)),
    )
    return room, stand, _arm(target, 2.0 * radius_m)


def _arm(target: Target, length_m: float) -> Thing:
    """Return the end of an arm that holds a target from behind."""
    behind_m = float(target.triangles_m[..., 0].min())
    return CylinderThing(
        kind="cylinder",
        radius_m=0.1 * target.radius_m,
        length_m=length_m,
        fixed_to="target",
        pose=make_pose(translation_m=(behind_m - length_m, 0.0, 0.0)),
    )


def _plate(distance_m: float, radius_m: float) -> Thing:
    """Return a plate that covers the left half of what is behind it."""
    width_m = 2.0 * radius_m
    return BoxThing(
        kind="box",
        size_m=(width_m, 4.0 * radius_m, 0.01 * radius_m),
        pose=make_pose(translation_m=(-0.5 * width_m, 0.0, distance_m)),
    )
