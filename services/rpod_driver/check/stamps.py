"""Lines about stamps: order, jitter, offset and drift of the clock."""

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from rpod_driver.check.delivery import few
from rpod_driver.check.observations import Observations
from rpod_driver.check.result import CheckResult, fail, note, ok, unchecked
from rpod_runtime.sensor_data.drift_watch import trend
from rpod_runtime.sensor_data.end_watch import EndWatch, last_of
from rpod_runtime.sensor_data.stamp_watch import TAI_S, clock_hint, is_boot_time, is_local_time
from rpod_schemas.arrays import MAD_TO_SIGMA, FloatArray
from rpod_schemas.config.estimator import EstimatorConfig
from rpod_schemas.config.estimator.filter import FilterConfig
from rpod_schemas.config.estimator.integrity import IntegrityConfig
from rpod_schemas.messages import NANOSECONDS
from rpod_schemas.types import SensorInfo

_JITTER_S, _JITTER_SHARE = 1e-3, 0.02
"""Greatest standard deviation of stamps: the ICD takes stamps 1 ms apart as those of one frame; and 2 % of a
period, which the motor of a turning scanner keeps."""
_DRIFT_PPM = 50.0
"""Greatest drift that an undisciplined quartz has over temperature; a synchronised one has none."""
_NO_CLOCK_PPM = 1e5
"""Drift that no clock has: even a clock that counts 1024 for 1000 has only a quarter of it."""
_DRIFT_SIGMAS = 5.0
_DRIFT_S, _STRETCHES, _LEAST_STRETCHES = 8.0, 8, 6
"""Least time for a drift, s; number of stretches whose least ages are compared, and least number of them.
Long stretches contain the shortest delay even on a loaded machine."""
_MOST_PARTS = 4
_TAI_WITHIN_S = 1.0


def order(seen: Observations) -> CheckResult:
    """Check whether stamps rise."""
    line = "order"
    if len(seen.leads) < 2:
        return unchecked(line, f"{len(seen.leads)} frames came")
    steps_ns = [later.stamp_ns - earlier.stamp_ns for earlier, later in pairwise(seen.leads)]
    same, back = sum(step == 0 for step in steps_ns), sum(step < 0 for step in steps_ns)
    text = f"{same} stamps repeated, {back} back, of {len(seen.leads)}"
    faults = [*(["repeated_stamps"] if same else []), *(["reordered_stamps"] if back else [])]
    return fail(line, text, *faults) if faults else ok(line, text)


def jitter(seen: Observations) -> CheckResult:
    """Check how even the stamps are, whatever frames are missing."""
    line = "jitter"
    if reason := few(seen):
        return unchecked(line, reason)
    period_s = seen.period_s
    if not np.isfinite(period_s):
        return unchecked(line, "stamps do not rise")
    steps_s = np.diff([heard.stamp_ns for heard in seen.leads]) / NANOSECONDS
    sigma_s = _scatter_s(steps_s, period_s)
    for each_s in _shorter(period_s, seen.options.rate_hz):
        if _scatter_s(steps_s, each_s) < _limit_s(each_s) < sigma_s:
            period_s, sigma_s = each_s, _scatter_s(steps_s, each_s)
    limit_s = _limit_s(period_s)
    text = f"{1e3 * sigma_s:.3f} ms about a period of {1e3 * period_s:.3f} ms, limit {1e3 * limit_s:.1f} ms"
    if sigma_s > limit_s:
        return fail(line, text, "stamp_jitter", jitter_s=sigma_s)
    return ok(line, text, jitter_s=sigma_s)


def _scatter_s(steps_s: FloatArray, period_s: float) -> float:
    """Return the standard deviation of stamps about multiples of a period, s."""
    off_s = steps_s - period_s * np.round(steps_s / period_s)
    return float(MAD_TO_SIGMA * np.median(np.abs(off_s - np.median(off_s))) / np.sqrt(2.0))


def _limit_s(period_s: float) -> float:
    return max(_JITTER_S, _JITTER_SHARE * period_s)


def _shorter(period_s: float, rate_hz: float | None) -> Iterator[float]:
    """Yield periods that the median step may be a multiple of, where a loaded machine leaves out frames.

    Stamps without any order scatter by a quarter of a period. Only periods count for which that is beyond the
    limit.
    """
    steps = [period_s / parts for parts in range(2, _MOST_PARTS + 1)]
    nominal = [1.0 / rate_hz] if rate_hz and period_s * rate_hz > 1.0 else []
    yield from (each_s for each_s in (*nominal, *steps) if 0.25 * each_s > 2.0 * _limit_s(each_s))


def clock(seen: Observations) -> CheckResult:
    """Check the stamps against the time of arrival, within the limits of the estimator."""
    line = "clock"
    if not seen.leads:
        return unchecked(line, "no frame came")
    ages_s = np.array([heard.arrival_ns - heard.stamp_ns for heard in seen.leads]) / NANOSECONDS
    least_s, middle_s = float(ages_s.min()), float(np.median(ages_s))
    late_s = FilterConfig().max_delay_s
    ahead_s = EstimatorConfig.model_fields["max_future_s"].default
    figures = {"least_age_s": least_s, "median_age_s": middle_s}
    if -ahead_s <= least_s and middle_s <= late_s:
        text = (
            f"frames arrive {1e3 * least_s:.1f} ms after their stamp at least, {1e3 * middle_s:.1f} ms mostly"
        )
        return _against_the_end(seen, line, text, figures)
    age_s = least_s if least_s < -ahead_s else middle_s
    stamp_ns = seen.leads[-1].stamp_ns
    if -ahead_s <= least_s <= late_s or 0.0 < 2.0 * least_s < middle_s:  # no clock: it delays all alike
        return _delayed(seen, line, least_s, middle_s, figures)
    where = f"{-age_s:.3f} s ahead of" if age_s < 0 else f"{age_s:.3f} s behind"
    text = f"stamps are {where} this machine's clock; {clock_hint(-age_s, stamp_ns)}"
    return fail(line, text, _name(-age_s, stamp_ns), **figures)


def _delayed(
    seen: Observations, line: str, least_s: float, middle_s: float, figures: dict[str, float]
) -> CheckResult:
    """Return why frames are late for another reason than the clock; then some of them come in time."""
    waits_s = np.array([heard.arrival_ns - (heard.sent_ns or heard.stamp_ns) for heard in seen.leads])
    on_link = all(heard.sent_ns for heard in seen.leads) and 2.0 * np.median(waits_s) > middle_s * NANOSECONDS
    where = "on the link" if on_link else "before they are sent: sensor, driver or machine are too slow"
    text = (
        f"frames mostly arrive {middle_s:.3f} s after their stamp, and at least {least_s:.3f} s after it, of "
        f"which a clock that is behind may be a part; they wait {where}"
    )
    return fail(line, text, "slow_link" if on_link else "slow_rate", **figures)


def _against_the_end(seen: Observations, line: str, text: str, figures: dict[str, float]) -> CheckResult:
    """Compare arrivals with the last measurement of each kept frame: none can arrive before it."""
    watch = EndWatch(seconds=max(1, len(seen.kept)))
    of_stamp = {heard.stamp_ns: heard for heard in seen.leads}
    duration_s = seen.info.duration_s if isinstance(seen.info, SensorInfo) else seen.options.source.duration_s
    for kept in seen.kept:
        if heard := of_stamp.get(kept.frame.stamp_ns):
            last = last_of(kept.frame, duration_s)
            watch.add(last, heard.stamp_ns, sent_ns=heard.sent_ns, arrival_ns=heard.arrival_ns)
    if watch.is_settled:
        figures = figures | {"after_end_s": watch.after_s}
        text = f"{text}; {watch.text}"
    sigma_s = IntegrityConfig.model_fields["clock_sigma_s"].default
    finding = watch.finding(clock_sigma_s=sigma_s, within_s=seen.options.source.arrives_within_s)
    if finding is None:
        return ok(line, f"{text}: transport and offset of the clock together", **figures)
    if finding.fault != "clock_behind":
        return fail(line, finding.text, finding.fault, **figures)
    return note(line, finding.text, **figures)


def _name(ahead_s: float, stamp_ns: int) -> str:
    if is_boot_time(ahead_s, stamp_ns):
        return "boot_clock"
    if abs(ahead_s - TAI_S) < _TAI_WITHIN_S:
        return "tai_clock"
    if is_local_time(ahead_s):
        return "local_time"
    return "clock_ahead" if ahead_s > 0 else "clock_behind"


def drift(seen: Observations) -> CheckResult:
    """Check whether the sensor's clock runs as fast as this machine's.

    Delays only add. So the least difference between arrival and stamp in each stretch follows the clock.
    """
    line = "drift"
    if reason := few(seen):
        return unchecked(line, reason)
    arrivals_s = np.array([heard.arrival_ns - seen.leads[0].arrival_ns for heard in seen.leads]) / NANOSECONDS
    ages_s = np.array([heard.arrival_ns - heard.stamp_ns for heard in seen.leads]) / NANOSECONDS
    ages_s -= ages_s[0]
    bins = (arrivals_s / max(arrivals_s[-1], 1e-9) * _STRETCHES).astype(np.intp).clip(0, _STRETCHES - 1)
    least = np.array(
        [np.flatnonzero(bins == each)[ages_s[bins == each].argmin()] for each in np.unique(bins)]
    )
    if arrivals_s[-1] < _DRIFT_S or len(least) < _LEAST_STRETCHES:
        told = f"the frames span {arrivals_s[-1]:.1f} s, at least {_DRIFT_S:g} s are needed"
        return unchecked(line, f"{told}; watch for longer: --duration {_DRIFT_S + 2.0:g}")
    found = trend(arrivals_s[least], ages_s[least])
    sigma_ppm, drift_ppm = 1e6 * found.sigma, -1e6 * found.slope
    limit_ppm = _DRIFT_PPM + _DRIFT_SIGMAS * sigma_ppm
    text = f"{drift_ppm:+.0f} ppm, standard deviation {sigma_ppm:.0f} ppm, limit {limit_ppm:.0f} ppm"
    figures = {"drift_ppm": drift_ppm, "sigma_ppm": sigma_ppm}
    if abs(drift_ppm) > _NO_CLOCK_PPM:
        return unchecked(line, f"{text}: no clock is that wrong; the frames' delay changes", **figures)
    if abs(drift_ppm) > limit_ppm and found.is_even:
        return fail(line, text, "clock_drift", **figures)
    if limit_ppm > 4.0 * _DRIFT_PPM or abs(drift_ppm) > limit_ppm:
        why = "arrivals are too irregular, or a load moves them in steps"
        return unchecked(line, f"{text}: {why}; watch for longer", **figures)
    return ok(line, text, **figures)
