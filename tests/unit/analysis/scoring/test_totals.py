"""What runs add up to, from logs with known errors."""

import numpy as np
import pytest
from synthetic_log import Frame, SyntheticRun

from rpod_analysis import open_log, stream_run
from rpod_analysis.report.downsampling import MOST_STRETCHES, Band, Samples
from rpod_analysis.scoring.row_store import Column
from rpod_analysis.scoring.run_checks import headline
from rpod_analysis.scoring.score import NEES_95
from rpod_analysis.scoring.summarise import summarise
from rpod_analysis.scoring.totals import RunTotals, summarise_durations, summarise_size
from rpod_schemas.types import Mode

T, L, A, V = Mode.TRACKING, Mode.LOST, Mode.ACQUIRING, Mode.VERIFYING


def totals_of(tmp_path, **options):
    with open_log(SyntheticRun(**options).write(tmp_path / "run.mcap")) as log:
        return RunTotals.of(*stream_run(log))


def test_lost_time_counts_lost_and_acquiring_after_the_first_tracking_only(tmp_path):
    modes = [A, A, V, T, T, L, A, V, T, L]
    totals = totals_of(tmp_path, duration_s=0.9, frame=lambda k, _: Frame(mode=modes[k]))
    assert totals.lost_ns == 200_000_000
    assert totals_of(tmp_path, duration_s=0.2, frame=lambda k, _: Frame(mode=modes[k])).lost_ns == 0


def test_changes_of_state_are_told_with_time_and_reason_and_counted_where_they_are_many(tmp_path):
    def frame(number, _time_s):
        lost = number in (7, 8)
        return Frame(mode=L if lost else A if number < 2 else T, reason="gate: nis 80.0" if lost else "")

    changes = totals_of(tmp_path, frame=frame).changes
    assert [(change.before, change.after, change.reason) for change in changes] == [
        (A, T, ""), (T, L, "gate: nis 80.0"), (L, T, ""),
    ]  # fmt: skip
    assert [change.explanation for change in changes] == [
        "a first pose was found and verified", "gate: nis 80.0", "a measurement was accepted",
    ]  # fmt: skip
    assert changes[1].time_s == pytest.approx(0.7 + 2 / 250)
    flapping = totals_of(tmp_path, duration_s=9.0, frame=lambda k, _: Frame(mode=L if k % 2 else T))
    assert (flapping.change_count, len(flapping.changes)) == (90, 12)


def test_a_mode_begins_after_the_frames_that_came_before_a_late_one(tmp_path):
    """A scan with the stamp 0.3 s arrives after the images of 0.4 and 0.5 s, and begins the track."""

    def frame(number, _time_s):
        late = number == 3
        return Frame(mode=T if late or number > 5 else V, latency_s=0.3 if late else 0.06)

    totals = totals_of(tmp_path, duration_s=1.0, frame=frame)
    (change,) = totals.changes
    assert (change.before, change.after) == (V, T)
    assert change.time_s == pytest.approx(0.5 + 2 / 250)
    assert totals.modes().first_tracking_s == pytest.approx(0.5 + 2 / 250)
    assert totals.modes().tracking_share == 1.0


def test_a_track_that_one_frame_ends_and_begins_again_is_told_with_its_reason(tmp_path):
    def frame(number, _time_s):
        return Frame(mode=V if number == 5 else T, evidence={"lost_after_s": 1.25} if number == 5 else {})

    totals = totals_of(tmp_path, frame=frame)
    assert totals.lost_ns == 100_000_000
    lost, again = totals.changes
    assert (lost.before, lost.after) == (T, V)
    assert lost.explanation == (
        "the track was lost: no measurement was accepted for 1.25 s, and the covariance of the prediction "
        "was beyond the alert limit; this frame begins it again"
    )
    assert again.explanation == "the next frames agree with the pose"


def test_the_worst_errors_are_told_with_their_times_in_the_headline(tmp_path):
    def frame(number, _time_s):
        return Frame(
            attitude_rad=(np.deg2rad(3.0) if number == 4 else 0.0, 0.0, 0.0),
            position_m=(0.0, 0.0, 0.2 if number == 9 else 0.0),
        )

    with open_log(SyntheticRun(frame=frame).write(tmp_path / "run.mcap")) as log:
        run = stream_run(log)
        totals = RunTotals.of(*run)
        line = headline(summarise(log, run, totals), totals)
    assert line == (
        "Acquired after 0.01 s, tracked 100 % of the time, at most 0 s without a track, "
        "worst errors 3.00° (at 0.4 s) and 200.0 mm (at 0.9 s), "
        "the log is complete."
    )


def test_the_headline_tells_the_longest_time_in_which_acquiring_and_verifying_alternate(tmp_path):
    def frame(number, _time_s):
        return Frame(mode=T if not 6 <= number < 13 else A if number % 2 else V)

    with open_log(SyntheticRun(frame=frame).write(tmp_path / "run.mcap")) as log:
        run = stream_run(log)
        totals = RunTotals.of(*run)
        line = headline(summarise(log, run, totals), totals)
    assert "tracked 65 % of the time, at most 0.7 s without a track" in line


def test_reasons_are_counted_by_kind_whatever_the_numbers_in_them(tmp_path):
    totals = totals_of(tmp_path, frame=lambda k, _: Frame(reason=f"gate: nis {20 + k}.5" if k % 2 else ""))
    assert totals.reasons.most_common(3) == [("gate: nis …", 10)]
    assert totals.by_sensor == {"pmd": {"accepted": 11, "rejected": 10}}


def test_sizes_are_rms_95_percent_and_maximum():
    size = summarise_size(Column(np.arange(1.0, 101.0)))
    assert size.rms == pytest.approx(np.sqrt((np.arange(1.0, 101.0) ** 2).mean()))
    assert (size.p95, size.max) == pytest.approx((95.05, 100.0))


def test_durations_leave_out_what_is_not_known():
    durations = summarise_durations(Column(np.array([0.01, np.nan, 0.03])))
    assert durations is not None
    assert (durations.p50, durations.max) == pytest.approx((0.02, 0.03))
    assert summarise_durations(Column(np.array([np.nan]))) is None


def test_the_share_counts_the_bound_itself():
    assert Column(np.array([0.0, NEES_95[6], 12.6, np.nan])).share_up_to(NEES_95[6]) == pytest.approx(2 / 3)


def test_a_band_of_very_many_stretches_keeps_the_longest():
    band, values = Band(), np.tile([2, 3], 20_000)
    stamps = np.cumsum(np.where(values == 3, 1, 1000))
    stamps[30_000:] += 50_000  # LOST for long at row 29,999
    for part in np.array_split(np.arange(40_000), 50):
        band.extend(stamps[part], values[part])
    assert band.start_ns.size <= 2 * MOST_STRETCHES
    assert (np.diff(band.values) != 0).all()
    held_ns = np.diff(band.start_ns, append=band.end_ns)
    assert held_ns[band.values == 3].max() >= 50_000
    assert band.left_out_ns > 0


def test_samples_are_spread_over_the_time():
    samples = Samples((0, 1000), 10, 1)
    for part in np.array_split(np.arange(1001), 7):
        samples.extend(part, part[:, None].astype(float))
    np.testing.assert_array_equal(samples.stamp_ns, np.arange(0, 1001, 100))
    np.testing.assert_array_equal(samples.rows[:, 0], samples.stamp_ns)
