"""Measurements in the order of their stamps, although some arrive late (ICD section 2).

A LIDAR's mid-scan stamp may be older than a camera's that was applied already. The history goes back to the
state before it, applies the measurement at its own stamp, and applies the later ones again. The result is the
same, bit for bit, as if they had arrived in order. The newest stamp never goes back.
"""

from bisect import bisect_right
from dataclasses import dataclass, replace
from math import inf
from typing import NamedTuple

from rpod_pose.navigation.dynamics.manoeuvre import explaining, followed, is_expected
from rpod_pose.navigation.dynamics.slewing import Met, chosen
from rpod_pose.navigation.dynamics.steady import decided
from rpod_pose.navigation.dynamics.unseen import with_unseen
from rpod_pose.navigation.filter import FilterState, Update, predict
from rpod_pose.navigation.pose_measurement import PoseMeasurement, updated
from rpod_schemas.config.estimator.filter import FilterConfig

KEPT_S = 1.0
"""Least time of the past that is kept, s. Numerics: longer than that of the newest frames, which the
integrity leaves out together (``group_s``)."""


class Applied(NamedTuple):
    """Result of a measurement, and the history that includes it."""

    history: "History"
    nis: float
    """Normalised innovation squared at the measurement's stamp; NaN if it came too late."""
    accepted: bool


@dataclass(frozen=True, eq=False)
class Step:
    """A measurement, and what the filter made of it."""

    measurement: PoseMeasurement
    predicted: FilterState
    """Prediction to the measurement's stamp."""
    outcome: Update
    """Update with the measurement, accepted or rejected."""


@dataclass(frozen=True, eq=False)
class History:
    """A filter's state with as much of its past as late measurements may need; immutable."""

    origin: FilterState
    """Oldest state: the filter's start, or the last state before ``steps``."""
    steps: tuple[Step, ...] = ()
    """Measurements since then, in the order of the stamps; equal stamps in the order of arrival."""

    @property
    def state(self) -> FilterState:
        """The state at the newest measurement's stamp, rejected or not."""
        return self.steps[-1].outcome.state if self.steps else self.origin

    def at(self, stamp_ns: int, config: FilterConfig) -> FilterState | None:
        """Return the prediction to a stamp from the measurements up to it; None if the stamp is too old."""
        before = self.before(stamp_ns, config)
        return None if before is None else predict(before, stamp_ns, config)

    def before(self, stamp_ns: int, config: FilterConfig) -> FilterState | None:
        """Return the state after the last measurement up to a stamp; None if the stamp is too old.

        A stamp is too old before the origin, or more than ``max_delay_s`` before the newest measurement.
        """
        if stamp_ns < max(self.origin.stamp_ns, self._oldest_ns(config)):
            return None
        place = self.place(stamp_ns)
        return self.steps[place - 1].outcome.state if place else self.origin

    def without_newest(self, stamp_ns: int) -> FilterState | None:
        """Return the state after the last measurement up to a stamp; None if the filter began later.

        Unlike ``before``, it does not depend on the delay up to which measurements are applied.
        """
        place = self.place(stamp_ns)
        if place:
            return self.steps[place - 1].outcome.state
        return self.origin if stamp_ns >= self.origin.stamp_ns else None

    def place(self, stamp_ns: int) -> int:
        """Return the index after the last step up to a stamp, equal stamps included."""
        return bisect_right(self.steps, stamp_ns, key=lambda step: step.measurement.stamp_ns)

    def since_s(self, stamp_ns: int, sensor: str) -> float:
        """Return the time from a sensor's accepted measurement before a stamp; infinite if it is unknown."""
        for step in reversed(self.steps[: self.place(stamp_ns)]):
            measured = step.measurement
            if step.outcome.accepted and measured.origin is not None and measured.origin.sensor == sensor:
                return (stamp_ns - measured.stamp_ns) * 1e-9
        return inf

    def applied_at(self, stamp_ns: int, sensor: str) -> Step | None:
        """Return the step with the newest measurement by a sensor at a stamp; None if there is none."""
        for step in reversed(self.steps[: self.place(stamp_ns)]):
            measured = step.measurement
            if measured.stamp_ns != stamp_ns:
                break
            if measured.origin is None or measured.origin.sensor == sensor:
                return step
        return None

    def pruned(self, config: FilterConfig) -> "History":
        """Return this history without the steps that are too old to be of use."""
        kept_s = max(config.max_delay_s, KEPT_S)
        first = self.place(self.state.stamp_ns - round(kept_s * 1e9) - 1)
        return History(self.steps[first - 1].outcome.state, self.steps[first:]) if first else self

    def _oldest_ns(self, config: FilterConfig) -> int:
        return self.state.stamp_ns - round(config.max_delay_s * 1e9)


def apply(
    history: History, measurement: PoseMeasurement, config: FilterConfig, predicted: FilterState | None = None
) -> Applied:
    """Return the history with a measurement at its place, and with the later ones gated and applied again.

    A measurement that is too old is not accepted, and nothing changes. ``predicted`` is the history's
    prediction to its stamp, if the caller has it already.
    """
    before = history.before(measurement.stamp_ns, config)
    if before is None:
        return Applied(history, float("nan"), accepted=False)
    predicted = predicted or predict(before, measurement.stamp_ns, config)
    place = history.place(measurement.stamp_ns)
    steps = [*history.steps[:place], _applied(measurement, before, predicted, config)]
    for later in history.steps[place:]:
        before = steps[-1].outcome.state
        predicted = predict(before, later.measurement.stamp_ns, config)
        steps.append(_applied(later.measurement, before, predicted, config))
    own = steps[place].outcome
    return Applied(History(history.origin, tuple(steps)).pruned(config), own.nis, own.accepted)


def after(before: FilterState, measurement: PoseMeasurement, config: FilterConfig) -> FilterState:
    """Return a state after a measurement that is not older, gated and applied as in a history."""
    predicted = predict(before, measurement.stamp_ns, config)
    return _applied(measurement, before, predicted, config).outcome.state


def _applied(
    measurement: PoseMeasurement, before: FilterState, predicted: FilterState, config: FilterConfig
) -> Step:
    """Return the step with a measurement.

    If the model of motion assumes that the chaser holds its attitude, another filter is beside the track.
    """
    step, met = _stepped(measurement, before, predicted, config)
    if before.model is None or not measurement.alone:
        return step

    def advance(earlier: FilterState, there: FilterState) -> FilterState:
        return _stepped(measurement, earlier, there, config)[0].outcome.state

    state = chosen(before, step.outcome.state, Met(measurement, met.innovation, config), advance)
    return replace(step, outcome=step.outcome._replace(state=state))


def _stepped(
    measurement: PoseMeasurement, before: FilterState, predicted: FilterState, config: FilterConfig
) -> tuple[Step, Update]:
    """Return the step of one filter with a measurement, and the update as the prediction met it.

    A pose that its frame alone proves may need larger accelerations than configured; then they are assumed.
    """
    outcome = updated(predicted, measurement, config)
    met = outcome
    if measurement.alone and not is_expected(outcome, predicted):
        manoeuvre = explaining(before, predicted, measurement, config)
        if manoeuvre is not None:
            raised = predict(replace(before, manoeuvre=manoeuvre), measurement.stamp_ns, config)
            again = updated(raised, measurement, config)
            if again.accepted:
                predicted, outcome = raised, again
    if outcome.accepted:
        after = followed(before, predicted, outcome, measurement, config)
        after = with_unseen(before, after, outcome.innovation, config)
        outcome = outcome._replace(state=decided(before, after, met, measurement, config))
    return Step(measurement, predicted, outcome), met
