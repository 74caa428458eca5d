"""Checks the motion of joints that a scenario asks for against the joints of its target."""

from math import degrees

from rpod_schemas.config.scenario import Scenario
from rpod_schemas.errors import ConfigurationError
from rpod_target import Target


def beyond(scenario: Scenario, target: Target) -> list[str]:
    """Return what of the joints' motion is beyond what the target's file allows, a sentence each.

    Raises:
        ConfigurationError: the target has no joint of that name.
    """
    known, told = {joint.name: joint for joint in target.joints}, []
    for name, motion in scenario.motion.joints.items():
        field = f"motion.joints.{name}"
        if name not in known:
            has = ", ".join(known) or "none"
            raise ConfigurationError(scenario.name, field, f"is no joint of {target.name}; it has {has}")
        least, greatest = (degrees(limit) for limit in known[name].limits_rad)
        first, last = motion.angle_deg, motion.angle_deg + motion.rate_deg_s * scenario.duration_s
        if min(first, last) < least - 1e-6 or max(first, last) > greatest + 1e-6:
            told.append(
                f"{field}: goes from {first:g} to {last:g} deg, and limits_deg of the target's file are "
                f"{least:g} to {greatest:g}: the estimator will not find it beyond them"
            )
        if abs(motion.rate_deg_s) > degrees(known[name].rate_rad_s) * (1.0 + 1e-9):
            told.append(
                f"{field}.rate_deg_s: is {motion.rate_deg_s:g}, and most_rate_deg_s of the target's file is "
                f"{degrees(known[name].rate_rad_s):g}: the estimator may lose it"
            )
    return told
