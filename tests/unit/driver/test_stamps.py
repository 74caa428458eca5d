"""Stamps of devices: UTC is kept, a count from power-up is mapped, and which it is is told once."""

import logging

import numpy as np
import pytest
from pydantic import ValidationError

from rpod_driver.stamps import StampConfig, StampMapper

NOW_NS = 1_700_000_000_000_000_000
MS = 1_000_000


def mapped(config, device_ns, arrivals_ns):
    clock = iter(arrivals_ns)
    mapper = StampMapper("front", config, now_ns=lambda: next(clock))
    return mapper, np.array([mapper.utc_ns(each) for each in device_ns])


def test_a_clock_of_utc_is_kept_to_the_nanosecond(caplog):
    caplog.set_level(logging.INFO)
    stamps = NOW_NS + np.arange(5) * 50 * MS
    mapper, told = mapped(StampConfig(), stamps.tolist(), (stamps + 20 * MS).tolist())
    assert told.tolist() == stamps.tolist()
    assert mapper.source == mapper.sync.stamp_source == "device"
    assert len(caplog.records) == 1


def test_a_tai_clock_is_not_mistaken_for_a_count_from_power_up():
    mapper, told = mapped(StampConfig(), [NOW_NS + 37_000 * MS], [NOW_NS])
    assert (mapper.source, told[0]) == ("device", NOW_NS + 37_000 * MS)


def test_stamps_of_a_device_are_corrected_before_they_are_judged(caplog):
    caplog.set_level(logging.INFO)
    _, told = mapped(StampConfig(ahead_s=37.0 - 0.004), [NOW_NS + 37_000 * MS], [NOW_NS])
    assert told[0] == NOW_NS + 4 * MS
    assert "less ahead_s (36.996 s)" in caplog.text
    hours = StampConfig(ahead_s=-43_200.0)  # a clock of the local time
    mapper, told = mapped(hours, [NOW_NS - 129_600_000 * MS], [NOW_NS])
    assert (mapper.source, told[0]) == ("device", NOW_NS - 86_400_000 * MS)


@pytest.mark.parametrize(
    ("config", "device_ns", "reason"),
    [
        ({"delay_s": 0.02}, NOW_NS, "delay_s (0.02 s) has no effect, since stamps are the device's"),
        ({"ahead_s": 37.0}, 9_000 * MS, "ahead_s (37 s) has no effect, since stamps are mapped to arrivals"),
        ({"ahead_s": 37.0}, None, "ahead_s (37 s) has no effect, since stamps are those of the arrival"),
    ],
)
def test_a_correction_without_effect_is_told_once(caplog, config, device_ns, reason):
    mapped(StampConfig(**config), [device_ns] * 3, [NOW_NS, NOW_NS + MS, NOW_NS + 2 * MS])
    assert caplog.text.count(reason) == 1


@pytest.mark.parametrize(
    "config",
    [
        {"source": "device", "delay_s": 0.1},
        {"source": "mapped", "ahead_s": 37.0},
        {"source": "host", "ahead_s": 1.0},
    ],
)
def test_a_correction_that_can_have_no_effect_is_refused(config):
    with pytest.raises(ValidationError, match="has no effect with source"):
        StampConfig(**config)


def test_a_count_from_power_up_is_never_taken_for_utc(caplog):
    mapper, told = mapped(StampConfig(), [324_896_000 * MS], [NOW_NS])
    assert mapper.source == "mapped"
    assert told[0] == NOW_NS
    assert "not UTC (the newest is 324896.000 s" in caplog.text


def test_mapped_stamps_have_less_jitter_than_arrivals():
    rng = np.random.default_rng(5)
    device = 1_000 * MS + np.arange(400) * 25 * MS
    delays = (5 * MS + rng.exponential(4 * MS, 400)).astype(int)
    _, told = mapped(StampConfig(), device.tolist(), (NOW_NS + device + delays).tolist())
    errors = (told - (NOW_NS + device))[100:] / MS
    assert errors.min() >= 5.0
    assert errors.max() < 5.5
    assert errors.std() < 0.1 < delays.std() / MS


def test_a_drift_of_a_hundred_ppm_stays_within_a_millisecond_and_stamps_rise():
    device = np.arange(0, 120_000, 100) * MS
    arrivals = NOW_NS + (device * (1 - 1e-4)).astype(int)
    _, told = mapped(StampConfig(), device.tolist(), arrivals.tolist())
    assert np.abs(told - arrivals).max() <= 1.1 * MS
    assert (np.diff(told) > 0).all()


def test_a_device_that_restarts_is_mapped_anew(caplog):
    _, told = mapped(StampConfig(), [9_000 * MS, 10 * MS], [NOW_NS, NOW_NS + 5_000 * MS])
    assert told.tolist() == [NOW_NS, NOW_NS + 5_000 * MS]
    assert "started again" in caplog.text


def test_a_device_without_stamps_is_stamped_at_arrival_less_the_delay():
    mapper, told = mapped(StampConfig(delay_s=0.02), [None, None], [NOW_NS, NOW_NS + 50 * MS])
    assert told.tolist() == [NOW_NS - 20 * MS, NOW_NS + 30 * MS]
    assert mapper.source == "host"


@pytest.mark.parametrize("device_ns", [9_000 * MS, None])
def test_a_scan_arrives_after_its_last_point_not_at_its_middle(device_ns):
    clock = iter([NOW_NS + 50 * MS, NOW_NS + 150 * MS])
    mapper = StampMapper("top", StampConfig(), now_ns=lambda: next(clock))
    assert mapper.utc_ns(device_ns, after_ns=50 * MS) == NOW_NS
    later_ns = device_ns and device_ns + 100 * MS
    assert mapper.utc_ns(later_ns, after_ns=48 * MS) == NOW_NS + (100 if device_ns else 102) * MS


@pytest.mark.parametrize("source", ["device", "mapped", "host"])
def test_a_source_that_is_configured_counts(source):
    mapper, _ = mapped(StampConfig(source=source), [NOW_NS - MS], [NOW_NS])
    assert mapper.source == source
