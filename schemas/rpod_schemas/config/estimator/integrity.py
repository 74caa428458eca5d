"""Configuration of the integrity monitor: its risk, and what no test of one sensor can see."""

from typing import Annotated

from pydantic import Field

from rpod_schemas.config.base import Config, NonNegative, Positive, Share
from rpod_schemas.config.tuning import Provenance, Tuning

Probability = Annotated[float, Field(gt=0, lt=1)]


class IntegrityTuning(Tuning):
    """Numbers of the tests and of the fault hypotheses."""

    group_s: Annotated[
        Positive, Provenance("physics", "a frame of the slowest camera, 5 Hz; of a slower sensor its newest")
    ] = 0.2
    """Time of the newest frames that one fault hypothesis leaves out together, s."""
    fault_share: Annotated[
        Probability,
        Provenance("paper", "Blanch et al. 2015: 1e-4, ARAIM's prior of a fault that a whole source shares"),
    ] = 1e-4
    """Probability with which a sensor is wrong although its poses are believed."""
    group_share: Annotated[
        Probability,
        Provenance(
            "physics",
            "1e-4, times one in a hundred that a wrong pose agrees with the prediction by chance: a gate of "
            "5 deg about each axis holds 0.1 % of all attitudes",
        ),
    ] = 1e-6
    """Probability with which the newest group of frames is wrong although the gate accepted it."""
    window_s: Annotated[
        Positive, Provenance("physics", "five scans of a LIDAR at 1 Hz; a fault of a second is seen whole")
    ] = 5.0
    """Time over which the residuals of a sensor are tested together, s."""
    correlated_s: Annotated[
        NonNegative, Provenance("physics", "errors of model and calibration last as long as a view does")
    ] = 1.0
    """Time within which the residuals of two frames count as one in the tests, s (as for rivals)."""
    memory_s: Annotated[
        Positive, Provenance("physics", "in this time a target that turns at 3 deg/s shows its other side")
    ] = 60.0
    """Time for which a jump of the estimate is an alert, s: as long as both attitudes may be right."""
    caution_risk: Annotated[
        Probability, Provenance("physics", "a probability: one in a thousand such tests fails by itself")
    ] = 1e-3
    """Probability at which a test makes the state caution."""
    clock_risk: Annotated[
        Probability,
        Provenance(
            "physics",
            "a minute is one look at two clocks: 60 looks an hour of 1e-4 are 0.006 false alerts an hour",
        ),
    ] = 1e-4
    """Probability at which the test of two clocks by the frames of a minute makes the state alert."""
    range_share: Annotated[
        Share,
        Provenance("physics", "drift of a time-of-flight clock and its temperature: 0.05 % of the range"),
    ] = 5e-4
    """Standard deviation of a slow drift of a sensor's ranges, over the range."""


class IntegrityConfig(Config):
    """The integrity monitor: protection levels and alerts.

    An error that all frames of one sensor share is in no residual. It enters the levels by a declared
    standard deviation: the three below are those of a sensor that was calibrated on the chaser.
    """

    risk: Probability = 1e-6
    """Probability for each estimate that its error is above the protection level without an alert. Set it to
    what the mission allows."""
    mount_sigma_deg: NonNegative = 0.02
    """Standard deviation of the attitude of a sensor's mount about each axis, deg. Set it to what your
    hand-eye calibration states; at 10 m, 0.02 deg move the target by 3.5 mm."""
    mount_sigma_m: NonNegative = 0.001
    """Standard deviation of the place of a sensor's mount along each axis, m. Set it likewise."""
    clock_sigma_s: NonNegative = 0.002
    """Standard deviation of a sensor's stamps, s. Set it to what PTP or chrony states; raise it for stamps
    that are taken on arrival."""
    tuning: IntegrityTuning = IntegrityTuning()
    """Limits and numbers of the method that are outside the public interface; change them only to study
    it."""
