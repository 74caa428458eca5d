"""Arrivals of a sequence's frames, by which the estimator sees that a sensor's clock was set.

A live estimator compares the stamps of a sensor with the arrival of its frames before it measures a pose. A
campaign has no link, so its arrivals are drawn: a frame arrives with a constant delay and a random one.
"""

from dataclasses import dataclass

from rpod_campaign.engine.trial.streams import stream
from rpod_runtime.sensor_data.step_watch import Step, StepWatch
from rpod_schemas.config.estimator import EstimatorSettings
from rpod_schemas.messages import NANOSECONDS

DELAY_S, JITTER_S = 0.020, 0.005
"""Constant delay of a frame, and mean of its random one, which is exponential, s."""
_ARRIVALS = 26
"""Stream of random numbers."""


@dataclass(frozen=True)
class ClockCheck:
    """What stamp and arrival of a frame tell of its sensor's clock."""

    step: Step | None = None
    """Step for which the estimator refuses the frame; None if it uses it."""
    corrected_s: float = 0.0
    """Change of the stamps that is believed since this frame, s; 0 for none."""


class Clocks:
    """The clocks of a sequence's sensors, as a live estimator checks them.

    Args:
        settings: settings of the estimator.
        seed: seed of the campaign.
        trial: number of the trial.
    """

    def __init__(self, settings: EstimatorSettings, seed: int, trial: int) -> None:
        self._noise = stream(seed, trial, _ARRIVALS)
        self._watches = {
            sensor.name: StepWatch(settings.integrity.clock_sigma_s, sensor.source.arrives_within_s)
            for sensor in settings.sensors
        }

    def checked(self, sensor: str, stamp_ns: int, time_s: float) -> ClockCheck:
        """Return the check of a frame that was measured at a time, s, whatever its stamp says."""
        arrival_s = time_s + DELAY_S + float(self._noise.exponential(JITTER_S))
        watch = self._watches[sensor]
        step = watch.add(stamp_ns, round(arrival_s * NANOSECONDS), arrival_s=arrival_s, source=sensor)
        return ClockCheck(step, watch.corrected_s)
