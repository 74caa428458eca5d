"""What is known of a scenario before it is played: whether its target can be seen and followed at all.

A unit that slipped, such as millimetres for metres, or a motion that is too fast for the stated priors, would
otherwise be noticed after a run of minutes, by frames that are all rejected.
"""

from collections.abc import Iterator
from math import pi
from typing import Any

import numpy as np

from rpod_schemas.config.motion import ApproachConfig
from rpod_schemas.config.scenario import Scenario

_FEWEST = 6
"""Least number of rays or pixels that can fix a pose."""


def unseen(scenario: Scenario, radius_m: float) -> Iterator[str]:
    """Yield a sentence for each sensor by which the target is too small in the whole scenario.

    Args:
        scenario: the scenario.
        radius_m: radius of the sphere about the target's origin that holds the target.
    """
    nearest_m, fields = _nearest(scenario)
    for sensor in scenario.sensors:
        solid_rad2 = _ray_rad2(sensor)
        if solid_rad2 is None or nearest_m <= radius_m:
            continue
        rays = pi * (radius_m / nearest_m) ** 2 / solid_rad2
        if rays < _FEWEST:
            yield (
                f"sensor {sensor.name!r} cannot measure a pose: the target is {2.0 * radius_m:.3g} m wide, "
                f"at least {nearest_m:.4g} m away; there it covers at most {rays:.2g} rays or pixels "
                f"({_FEWEST} are needed). {fields} in metres?"
            )


def too_fast(scenario: Scenario) -> str:
    """Return a sentence if the target moves faster than the estimator is told to expect; empty if not."""
    path, stated_m_s = scenario.motion.trajectory, scenario.estimator.filter.initial_velocity_sigma_m_s
    if stated_m_s is None or not isinstance(path, ApproachConfig):
        return ""
    way_m = float(np.abs(path.end_m - path.start_m).max()) / (1.0 - path.ramp_share)
    fastest_m_s, expected_m_s = way_m / scenario.duration_s, 3.0 * stated_m_s
    if fastest_m_s <= expected_m_s:
        return ""
    return (
        f"the approach reaches {fastest_m_s:.2g} m/s in a run of {scenario.duration_s:g} s, and "
        f"estimator.filter.initial_velocity_sigma_m_s of {stated_m_s:g} expects at most {expected_m_s:.2g} "
        f"m/s: a track may not begin; play it in {way_m / expected_m_s:.0f} s or more, or state "
        f"{fastest_m_s / 3.0:.2g}"
    )


def _nearest(scenario: Scenario) -> tuple[float, str]:
    """Return the least distance of the target's origin, m, and a question about the fields that give it."""
    path = scenario.motion.trajectory
    if not isinstance(path, ApproachConfig):
        return path.least_range_m, "Is motion.trajectory.least_range_m"
    along_m = path.end_m - path.start_m
    share = np.clip(-(path.start_m @ along_m) / max(float(along_m @ along_m), 1e-300), 0.0, 1.0)
    nearest_m = float(np.linalg.norm(path.start_m + share * along_m))
    return nearest_m, "Are motion.trajectory.start_m and end_m"


def _ray_rad2(sensor: Any) -> float | None:
    """Return the solid angle between the rays of a sensor, rad2; None for a sensor of an unknown kind."""
    camera, pattern = getattr(sensor, "camera", None), getattr(sensor, "pattern", None)
    if camera is not None:
        return 1.0 / float(camera.fx * camera.fy)
    step_deg = getattr(pattern, "step_deg", None)
    return None if step_deg is None else float(np.radians(step_deg)) ** 2
