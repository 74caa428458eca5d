"""Measurements in the order of their stamps, although some arrive late (ICD section 2).

A LIDAR's mid-scan stamp lies behind a camera's that has been applied already. The history goes back to
the state before it, applies the measurement at its own stamp, and those after it once more: the result
is, bit for bit, that of their arrival in order. The newest stamp never goes back.
"""

from bisect import bisect_right
from dataclasses import dataclass
from typing import NamedTuple

from scipy.spatial.transform import RigidTransform

from rpod_pose.navigation.filter import FilterState, Update, predict, update
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.filter import FilterConfig


@dataclass(frozen=True, eq=False)
class PoseMeasurement:
    """A pose measured at a time."""

    stamp_ns: int
    T_chaser_target: RigidTransform
    covariance: FloatArray
    """Of (dp, dtheta), ICD section 1, shape (6, 6)."""


class Applied(NamedTuple):
    """The outcome of a measurement, and the history with it."""

    history: "History"
    nis: float
    """Normalised innovation squared at the measurement's stamp; NaN where it came too late."""
    accepted: bool


@dataclass(frozen=True, eq=False)
class _Step:
    measurement: PoseMeasurement
    outcome: Update


@dataclass(frozen=True, eq=False)
class History:
    """A filter's state and as much of its past as late measurements may need; immutable."""

    origin: FilterState
    """Where it begins: the filter's start, or the last state before ``steps``."""
    steps: tuple[_Step, ...] = ()
    """What was measured since, in the order of the stamps; equal stamps in the order of arrival."""

    @property
    def state(self) -> FilterState:
        """The state at the newest measurement's stamp, rejected or not."""
        return self.steps[-1].outcome.state if self.steps else self.origin

    def at(self, stamp_ns: int, config: FilterConfig) -> FilterState | None:
        """Return the prediction to a stamp from what was measured up to it; None where it is too old."""
        before = self.before(stamp_ns, config)
        return None if before is None else predict(before, stamp_ns, config)

    def before(self, stamp_ns: int, config: FilterConfig) -> FilterState | None:
        """Return the state after the last measurement up to a stamp; None where it is too old.

        Too old is what lies before the origin, or more than ``max_delay_s`` behind the newest measurement.
        """
        if stamp_ns < max(self.origin.stamp_ns, self._oldest_ns(config)):
            return None
        place = self.place(stamp_ns)
        return self.steps[place - 1].outcome.state if place else self.origin

    def place(self, stamp_ns: int) -> int:
        """Return the index behind the steps up to a stamp, equal ones included."""
        return bisect_right(self.steps, stamp_ns, key=lambda step: step.measurement.stamp_ns)

    def pruned(self, config: FilterConfig) -> "History":
        """Return this history without the steps that no late measurement reaches any more."""
        first = self.place(self._oldest_ns(config) - 1)
        return History(self.steps[first - 1].outcome.state, self.steps[first:]) if first else self

    def _oldest_ns(self, config: FilterConfig) -> int:
        return self.state.stamp_ns - round(config.max_delay_s * 1e9)


def apply(
    history: History, measurement: PoseMeasurement, config: FilterConfig, predicted: FilterState | None = None
) -> Applied:
    """Return the history with a measurement at its place, and those after it judged and applied anew.

    A measurement that is too old is not accepted, and nothing changes. ``predicted`` is what the history
    predicts ``at`` its stamp, where that is known already.
    """
    predicted = predicted or history.at(measurement.stamp_ns, config)
    if predicted is None:
        return Applied(history, float("nan"), accepted=False)
    place = history.place(measurement.stamp_ns)
    steps = [*history.steps[:place], _judged(measurement, predicted, config)]
    for later in history.steps[place:]:
        predicted = predict(steps[-1].outcome.state, later.measurement.stamp_ns, config)
        steps.append(_judged(later.measurement, predicted, config))
    own = steps[place].outcome
    return Applied(History(history.origin, tuple(steps)).pruned(config), own.nis, own.accepted)


def _judged(measurement: PoseMeasurement, predicted: FilterState, config: FilterConfig) -> _Step:
    outcome = update(predicted, measurement.T_chaser_target, measurement.covariance, config=config)
    return _Step(measurement, outcome)
