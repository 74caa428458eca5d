"""Comparison of a sensor's clock, as its stamps show it, with the clock of this machine.

Not used in lockstep, where the time of the bus is the time of the stamps.
"""

import logging

import numpy as np

from rpod_estimator.inputs.book import SensorBook
from rpod_runtime import Received
from rpod_runtime.health import HealthBook
from rpod_runtime.sensor_data.drift_watch import DriftWatch
from rpod_runtime.sensor_data.end_watch import EndWatch, Last
from rpod_runtime.sensor_data.late_watch import LateWatch
from rpod_runtime.sensor_data.stamp_watch import StampWatch
from rpod_runtime.sensor_data.step_watch import Step, StepWatch
from rpod_schemas.config.estimator import EstimatorConfig
from rpod_schemas.config.sensor import SensorInput
from rpod_schemas.errors import MessageRejectedError, Reason

log = logging.getLogger(__name__)

OVERTAKEN = (
    "its frames arrive out of order ({} so far): the stamp of a frame fits between those of two before it, "
    "so that its clock is right; let its driver publish in the order of the stamps, and look at links over "
    "several ways"
)
"""Text for the operator about frames that arrive after newer ones, with their number."""


class ClockStepError(MessageRejectedError):
    """A frame whose clock was set since the frames before."""

    def __init__(self, step: Step) -> None:
        super().__init__(Reason.CLOCK_STEP, step.text)
        self.moved_s = step.moved_s
        """Change of the stamps against their arrival, s."""


class SensorClock:
    """Follows the stamps of one sensor; its findings go to the sensor's book, its figures to diagnostics.

    Stamps are ns of UTC, of the middle of an exposure or scan.
    """

    def __init__(
        self, sensor: SensorInput, config: EstimatorConfig, book: SensorBook, health: HealthBook
    ) -> None:
        self._name, self._book, self._health = sensor.name, book, health
        self._sigma_s, self._within_s = config.integrity.clock_sigma_s, sensor.source.arrives_within_s
        self._ages, self._drift, self._end = StampWatch(), DriftWatch(), EndWatch()
        self._lates, self._steps = (
            LateWatch(config.filter.max_delay_s),
            StepWatch(self._sigma_s, self._within_s),
        )
        self._corrected_s, self._overtaken = 0.0, 0

    def note_arrival(self, leading: Received, stamp_ns: int) -> None:
        """Compare the stamp of a frame's leading part with its sending and arrival."""
        arrival_ns = leading.arrival_ns
        self._lates.add(
            stamp_ns,
            arrival_ns,
            arrival_s=leading.arrival_s,
            sent_ns=leading.attachment.stamp_ns,
            source=leading.peer,
        )
        self._ages.add(stamp_ns, arrival_ns)
        self._health.measure(f"stamp_age_s/{self._name}", self._ages.age_s)
        if np.isfinite(self._ages.drift_ppm):
            self._health.measure(f"clock_drift_ppm/{self._name}", self._ages.drift_ppm)
        if self._drift.add(stamp_ns, arrival_ns):
            drift = self._drift.drift(self._sigma_s)
            self._book.note("drift", drift.describe(self._sigma_s) if drift is not None else "")

    def check_step(self, leading: Received, stamp_ns: int) -> None:
        """Check that the clock was not set since the previous frames. Raises ``ClockStepError``."""
        step = self._steps.add(stamp_ns, leading.arrival_ns, arrival_s=leading.arrival_s, source=leading.peer)
        if self._steps.overtaken != self._overtaken:
            self._overtaken = self._steps.overtaken
            self._health.put(f"overtaken/{self._name}", self._overtaken)
            self._book.tell(leading.arrival_s, OVERTAKEN.format(self._overtaken))
        if self._steps.ended:
            log.warning("%s: %s", self._name, self._steps.ended)
        self._corrected_s = self._steps.corrected_s or self._corrected_s
        if step is not None:
            raise ClockStepError(step)

    def take_correction_s(self) -> float:
        """Return by how much a clock has moved that is believed since the last call, s; 0 for none."""
        corrected_s, self._corrected_s = self._corrected_s, 0.0
        return corrected_s

    def accept_step(self) -> None:
        """Accept the clock as it is now."""
        self._steps.forget()
        self._corrected_s = 0.0

    def note_end(self, last: Last, leading: Received, stamp_ns: int) -> None:
        """Compare the last measurement of a frame with its sending and arrival."""
        was_settled = self._end.is_settled
        self._end.add(last, stamp_ns, sent_ns=leading.attachment.stamp_ns, arrival_ns=leading.arrival_ns)
        self._health.measure(f"arrives_after_s/{self._name}", self._end.after_s)
        finding = self._end.finding(clock_sigma_s=self._sigma_s, within_s=self._within_s)
        self._book.note("clock", finding.text if finding is not None else "")
        if self._end.is_settled and not was_settled:
            log.info("%s: frames arrive %s", self._name, self._end.text)

    def why_late(self) -> str:
        """Return why its frames are late, with the remedy; empty if their arrival does not show it."""
        return self._lates.why()
