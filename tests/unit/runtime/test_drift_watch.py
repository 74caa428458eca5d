"""When the drift of a sensor's clock is told: by what is declared of its stamps, and by the scatter."""

import numpy as np
import pytest

from rpod_runtime.sensor_data.drift_watch import DriftWatch
from rpod_schemas.messages import NANOSECONDS

START_NS = 1_767_225_600 * NANOSECONDS
SIGMA_S = 0.002


def watched(drift_ppm, seconds, *, rate_hz=10.0, wait_s=0.003, seed=0, step_s=0.0):
    """Return what is told after frames of a clock with a drift, whose delays are exponential.

    ``step_s`` is a delay that comes in the middle and stays, as of a machine that is loaded from then on.
    """
    random, watch = np.random.default_rng(seed), DriftWatch()
    for number in range(round(seconds * rate_hz)):
        time_s = number / rate_hz
        late_s = 0.01 + random.exponential(wait_s) + step_s * (time_s > 0.5 * seconds)
        stamp_ns = START_NS + round((time_s * (1.0 + 1e-6 * drift_ppm)) * NANOSECONDS)
        watch.add(stamp_ns, START_NS + round((time_s + late_s) * NANOSECONDS))
    return watch.drift(SIGMA_S)


@pytest.mark.parametrize(
    ("drift_ppm", "seconds", "is_told"),
    [(300.0, 70, True), (-300.0, 70, True), (50.0, 120, False), (50.0, 240, True), (20.0, 600, True),
     (1.0, 1800, False), (0.0, 600, False)],
)  # fmt: skip
def test_a_drift_is_told_once_it_has_moved_the_stamps_beyond_what_is_declared(drift_ppm, seconds, is_told):
    drift = watched(drift_ppm, seconds)
    assert (drift is not None) == is_told
    if drift is not None:
        assert drift.ppm == pytest.approx(drift_ppm, rel=0.1)
        assert drift.moved_s > 4.0 * SIGMA_S


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("rate_hz", [1.0, 10.0])
def test_arrivals_on_a_loaded_machine_are_no_drift(rate_hz, seed):
    assert watched(0.0, 300, rate_hz=rate_hz, wait_s=0.03, seed=seed) is None
    assert watched(0.0, 300, rate_hz=rate_hz, wait_s=0.01, seed=seed, step_s=0.05) is None


def test_figures_and_remedy_are_told():
    text = watched(300.0, 70).describe(SIGMA_S)
    assert text.startswith("its clock runs 301 ppm too fast: its stamps have moved by 18.0 ms in 60 s")
    assert "integrity.clock_sigma_s declares 2 ms; synchronise the sensor by PTP or chrony" in text
    assert "look at the driver's queue" in watched(-300.0, 70).describe(SIGMA_S)
