"""How a sensor joins the track of others: one filter with it and one without it (solution separation).

The sensors that began the track, or that have supported it alone since, are established. The frames of
another sensor, a newcomer, update a second filter. The newcomer joins when two successive frames of
established sensors agree with both filters. If such a frame later agrees only with the filter without the
newcomer, the newcomer is excluded again. When no established sensor delivers any more, the newcomer becomes
established. Source of the idea: R. G. Brown and P. W. McBurney, Self-contained GPS integrity check using
maximum solution separation, Navigation 35 (1988).
"""

from collections.abc import Set
from dataclasses import dataclass, replace

from rpod_pose.navigation.filter import is_consistent
from rpod_pose.navigation.history import Applied, History, apply
from rpod_pose.navigation.pose_measurement import PoseMeasurement
from rpod_schemas.config.estimator.filter import FilterConfig

AGREEMENTS = 2
"""Number of frames of established sensors that must agree. Hand: at the first one, the newcomer may have
delivered only for a moment; between two of them a wrong newcomer has time to move its filter away."""
PROBATION = "offered: the sensor joins the track when the next frames of {} agree"
"""Reason for which a newcomer's pose is not used yet."""


@dataclass(frozen=True, eq=False)
class Separation:
    """The filters with and without the newcomers."""

    without: History
    """Filter of the established sensors alone."""
    including: History
    """Filter of all sensors."""
    agreed: int = 0
    """Number of frames of established sensors in succession that agree with both."""

    @property
    def joined(self) -> bool:
        """Whether the newcomers have joined: then the filter of all sensors is the published one."""
        return self.agreed >= AGREEMENTS

    @property
    def published(self) -> History:
        """The filter whose estimates are published."""
        return self.including if self.joined else self.without


def update_separation(
    separation: Separation, measured: PoseMeasurement, config: FilterConfig
) -> tuple[Applied, Separation | None]:
    """Return what a frame of an established sensor makes of the published filter, and of the separation."""
    without = apply(separation.without, measured, config)
    including = apply(separation.including, measured, config)
    if not (without.accepted or including.accepted):
        kept = replace(separation, without=without.history, including=including.history)
        return including if kept.joined else without, kept
    agree = including.accepted and _agree(without, including, measured.stamp_ns, config)
    if without.accepted and not agree:
        return without, None
    alone = without if without.accepted else including
    kept = Separation(alone.history, including.history, separation.agreed + 1)
    return including if kept.joined else alone, kept


def _agree(without: Applied, including: Applied, stamp_ns: int, config: FilterConfig) -> bool:
    """Return whether the filters' poses agree after a frame that both have been given."""
    one, other = (each.history.at(stamp_ns, config) for each in (without, including))
    return one is None or other is None or is_consistent(one, other, config)


def probation(established: Set[str]) -> str:
    """Return the reason for which a newcomer's pose is not used yet."""
    return PROBATION.format(" or ".join(sorted(established)))
