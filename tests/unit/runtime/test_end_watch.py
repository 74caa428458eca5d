"""What stamps and arrivals of a sensor's frames say against each other."""

import numpy as np
import pytest

from rpod_runtime.sensor_data.end_watch import EndWatch, Last, last_of
from rpod_schemas.types import Camera, LidarScan, PmdFrame, SensorFrame

SECOND_NS = 1_000_000_000
EPOCH_NS = 1_767_225_600 * SECOND_NS
HALF_SCAN_S = 0.05
CAMERA = Camera(width=2, height=2, fx=2.0, fy=2.0, cx=0.5, cy=0.5)
POINTS = Last(HALF_SCAN_S, "their last point", -HALF_SCAN_S)

STATED = POINTS._replace(lasts_s=2.0 * HALF_SCAN_S)


def watched(late_s=0.0, *, readout_s=0.01, host_s=0.0, last=POINTS, rate_hz=1.0, seconds=6, jitter_s=0.02):
    """Return the watch of a sensor whose stamps are late, and whose driver's host is ahead by ``host_s``."""
    rng, watch, arrival_ns = np.random.default_rng(1), EndWatch(), 0
    for number in range(round(seconds * rate_hz)):
        measured_ns = EPOCH_NS + round(number / rate_hz * SECOND_NS)
        sent_ns = measured_ns + round((HALF_SCAN_S + readout_s) * SECOND_NS)
        delayed_ns = sent_ns + round((0.001 + rng.exponential(jitter_s)) * SECOND_NS)
        arrival_ns = max(arrival_ns, delayed_ns)  # messages do not overtake each other
        stamp_ns = measured_ns + round((late_s + host_s) * SECOND_NS)
        watch.add(last, stamp_ns, sent_ns=sent_ns + round(host_s * SECOND_NS), arrival_ns=arrival_ns)
    return watch


def found(watch, *, clock_sigma_s=0.002, within_s=0.1):
    finding = watch.finding(clock_sigma_s=clock_sigma_s, within_s=within_s)
    return finding and (finding.fault, finding.text)


@pytest.mark.parametrize("rate_hz", [1.0, 5.0, 10.0])
@pytest.mark.parametrize("readout_s", [0.0, 0.01, 0.06])
def test_a_sensor_whose_clock_agrees_is_not_suspected(rate_hz, readout_s):
    assert found(watched(rate_hz=rate_hz, readout_s=readout_s)) is None


@pytest.mark.parametrize("rate_hz", [1.0, 10.0])
def test_frames_that_come_before_their_last_point_prove_that_stamps_are_late(rate_hz):
    fault, text = found(watched(0.1, rate_hz=rate_hz))
    assert fault == "clock_ahead"
    assert "frames arrive before their last point, 0.050 s after the stamp" in text
    assert "synchronise" in text
    proven_s = float(text.split("at least ")[1].split()[0])
    assert 0.05 < proven_s <= 0.1


def test_one_frame_alone_proves_nothing():
    watch = watched(seconds=3)
    watch.add(POINTS, EPOCH_NS + 4 * SECOND_NS, sent_ns=0, arrival_ns=EPOCH_NS + 3 * SECOND_NS)
    assert found(watch) is None
    assert found(watched(0.1, seconds=2)) is None


def test_what_the_clock_is_declared_to_be_off_by_is_allowed():
    late = watched(0.02, readout_s=0.0, jitter_s=1e-4)
    assert found(late) is not None
    assert found(late, clock_sigma_s=0.005) is None


def test_frames_that_come_before_they_were_sent_name_the_clock_of_the_drivers_host():
    _, text = found(watched(host_s=0.2, jitter_s=1e-3))
    assert "before they were sent" in text
    assert "driver's host is ahead" in text


def test_frames_that_always_come_long_after_their_last_point_are_suspected():
    fault, text = found(watched(-0.3, last=STATED))
    assert fault == "clock_behind"
    assert "may be up to 0.3" in text
    assert "source.arrives_within_s" in text
    assert "stamps of the start" not in text
    assert found(watched(-0.3, last=STATED), within_s=0.5) is None
    untimed = watched(-0.3, last=Last(HALF_SCAN_S, "the end of a scan of 0.100 s", None, 2.0 * HALF_SCAN_S))
    assert "stamps of the start (set source.stamp" in found(untimed)[1]


def test_a_scan_without_a_stated_duration_may_last_a_whole_period():
    assert found(watched(-0.3)) is None  # at 1 Hz its rays may go on for 1 s after the first point
    assert found(watched(-0.3, rate_hz=10.0))[0] == "clock_behind"


def test_a_target_that_fills_the_first_part_of_a_scan_is_no_suspicion():
    """The last return is 0.45 s before the end of a scan of 1 s; the rays after it met nothing."""
    last = Last(HALF_SCAN_S, "their last point", -0.5, 1.0)
    assert found(watched(readout_s=0.45, last=last)) is None
    assert found(watched(-0.3, readout_s=0.45, last=last))[0] == "clock_behind"


@pytest.mark.parametrize("lasts_s", [0.0, 0.1])
def test_times_of_points_in_another_unit_are_named_not_taken_for_a_clock(lasts_s):
    fault, text = found(watched(last=Last(50.0, "their last point", -50.0, lasts_s)))
    assert fault == "point_time_unit"
    assert "span 100 s, scans come each 1.000 s" in text
    assert "send seconds from the stamp as float32 t" in text
    assert ("states 0.100 s" in text) == bool(lasts_s)


def test_a_loaded_machine_that_delays_some_frames_is_no_suspicion():
    assert found(watched(rate_hz=10.0, jitter_s=0.2)) is None


def scan(time_s, *, misses=()):
    points_m = np.ones((4, 3), np.float32)
    points_m[list(misses)] = np.nan
    times = None if time_s is None else np.array(time_s, np.float32)
    return LidarScan(stamp_ns=1, frame_id="", points_m=points_m, time_s=times)


def test_the_last_return_counts_not_a_ray_that_met_nothing():
    last = last_of(scan([-0.2, 0.0, 0.1, 0.3], misses=[3]), 1.0)
    assert (last.after_s, last.what) == (pytest.approx(0.1), "their last point")
    assert last.ends_s(9.0) == pytest.approx(0.8)  # 1 s after the first ray
    assert last_of(scan([-0.2, 0.0, 0.1, 0.3]), 0.0).ends_s(2.0) == pytest.approx(1.8)


def test_without_times_of_points_the_stated_duration_counts_and_without_it_the_stamp():
    assert last_of(scan(None), 0.4).after_s == pytest.approx(0.2)
    assert last_of(scan(None), 0.4).what == "the end of a scan of 0.400 s"
    assert last_of(scan(None), 0.0).after_s == 0.0
    frame = PmdFrame(
        stamp_ns=1, frame_id="", depth_m=np.ones((2, 2), np.float32), amplitude=None, camera=CAMERA
    )
    assert last_of(frame, 0.02).what == "the end of an exposure of 0.020 s"


class RadarSweep(SensorFrame):
    """A frame of a kind that another package brings, with times of its returns."""

    taken_in = "a sweep"

    @property
    def return_times_s(self):
        return np.array([-0.1, 0.2, np.nan], np.float32)

    @property
    def begins_s(self):
        return -0.3


def test_the_last_return_of_another_packages_frame_counts_too():
    last = last_of(RadarSweep(stamp_ns=1, frame_id=""), 0.5)
    assert (last.after_s, last.begins_s) == (pytest.approx(0.2), pytest.approx(-0.3))
