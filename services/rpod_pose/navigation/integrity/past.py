"""The estimate compared with its own past: with the predictions from where it was before.

A contradiction means that the track has jumped, as to another attitude that looks alike, or that the target
was accelerated by more than the filter's densities say. The test cannot know which. So the alert lasts for as
long as both attitudes may be right, and names both causes.

While no frame supports the track, the target may have got any velocity that a mission allows. Its velocity
is then as unknown as where a track begins, and its position says little of a jump. Its attitude says more,
and is tested as before: a search after a gap may find another one. Where the model of motion knows the
accelerations, as in free flight, the velocity stays known.
"""

from dataclasses import dataclass, replace
from math import degrees

import numpy as np

from rpod_pose.navigation.dynamics.manoeuvre import greatest
from rpod_pose.navigation.dynamics.slewing import relied_on
from rpod_pose.navigation.filter import ATTITUDE, CALM, POSITION, FilterState, predict, separation_of
from rpod_pose.navigation.integrity.residuals import separation_test
from rpod_schemas.config.estimator.filter import FilterConfig
from rpod_schemas.config.estimator.integrity import IntegrityConfig
from rpod_schemas.messages import NANOSECONDS

_OLDEST_S = 300.0
"""Age up to which a former estimate is compared, s. Numerics: readings of the IMU are kept for as long; a
prediction of a tumbling body over hours would take minutes."""
_NUMBER = 3
"""Number of former estimates that are kept. Numerics: a budget; with half a window between two of them they
reach back for one and a half windows."""
REMEDY = (
    "; the track has jumped, or the target was accelerated by more than filter.acceleration_density_m2_s3 "
    "and filter.angular_acceleration_density_rad2_s3 allow: if the estimate is right, a reset ends this alert"
)
"""Text on the two causes of a contradiction, with the remedy."""


@dataclass(frozen=True, eq=False)
class Past:
    """Where the estimate was before, and whether it has contradicted that."""

    anchors: tuple[FilterState, ...] = ()
    """Former estimates, oldest first."""
    unseen_ns: int | None = None
    """Beginning of the last time without supporting frames for which the velocity of the anchors was
    forgotten."""
    contradicted_ns: int | None = None
    """Newest stamp at which the estimate contradicted its past."""
    contradiction: str = ""

    def compared(
        self, estimate: FilterState, *, unseen_ns: int | None, config: IntegrityConfig, filtered: FilterConfig
    ) -> "Past":
        """Return the past with an estimate that frames support compared with it, and added to it.

        While estimate and past contradict each other, the remembered past stays as it is.

        Args:
            estimate: the estimate.
            unseen_ns: beginning of the newest time in which no frame supported the track; None for none.
            config: configuration of the monitor.
            filtered: configuration of the filter.
        """
        oldest_ns = estimate.stamp_ns - round(_OLDEST_S * NANOSECONDS)
        past = replace(
            self, anchors=tuple(x for x in self.anchors if oldest_ns <= x.stamp_ns <= estimate.stamp_ns)
        )
        if unseen_ns is not None and unseen_ns != past.unseen_ns:
            anchors = tuple(
                _with_unknown_velocity(each, estimate.stamp_ns, unseen_ns, filtered) for each in past.anchors
            )
            past = replace(past, anchors=anchors, unseen_ns=unseen_ns)
        for anchor in past.anchors:
            there = predict(anchor, estimate.stamp_ns, filtered)
            test = separation_test("the estimate and its prediction from before", estimate, there)
            if test.exceeds_risk(config.risk):
                text = f"{test.describe(config.risk)}, {_apart(estimate, there)}{REMEDY}{relied_on(anchor)}"
                return replace(past, contradicted_ns=estimate.stamp_ns, contradiction=text)
        gap_ns = round(0.5 * config.tuning.window_s * NANOSECONDS)
        if not past.anchors or estimate.stamp_ns - past.anchors[-1].stamp_ns >= gap_ns:
            past = replace(past, anchors=(*past.anchors, estimate)[-_NUMBER:])
        return past

    def alert(self, stamp_ns: int, memory_s: float) -> str:
        """Return why an estimate at a stamp must not be used; empty if nothing of its past contradicts it."""
        if self.contradicted_ns is None:
            return ""
        since_s = (stamp_ns - self.contradicted_ns) / NANOSECONDS
        return f"{since_s:.1f} s ago: {self.contradiction}" if since_s <= memory_s else ""


def _with_unknown_velocity(
    anchor: FilterState, stamp_ns: int, unseen_ns: int, config: FilterConfig
) -> FilterState:
    """Return an anchor predicted over a time without frames, which ends at a stamp.

    It is a former estimate still, but for what accelerations of a mission may have done in this time.
    """
    begun = predict(anchor, max(anchor.stamp_ns, unseen_ns), config)
    step_s = (stamp_ns - begun.stamp_ns) / NANOSECONDS
    if step_s <= 0.0:
        return begun
    manoeuvre = CALM._replace(acceleration=max(1.0, greatest(step_s, begun, config).acceleration))
    moved = predict(replace(begun, manoeuvre=manoeuvre), stamp_ns, config)
    return replace(moved, manoeuvre=anchor.manoeuvre)


def _apart(estimate: FilterState, there: FilterState) -> str:
    """Return in words how far an estimate is from a prediction."""
    off = separation_of(estimate, there)
    turn_deg, shift_m = degrees(float(np.linalg.norm(off[ATTITUDE]))), float(np.linalg.norm(off[POSITION]))
    return f"{turn_deg:.1f} deg and {1e3 * shift_m:.0f} mm apart"
