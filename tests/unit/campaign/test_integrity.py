"""The campaign of faults: what a fault does to a frame, and how rows become a summary."""

import numpy as np
import polars as pl
import pytest
from scipy.spatial.transform import Rotation

from rpod.scenarios import find
from rpod_campaign.engine.campaign import CellResult
from rpod_campaign.engine.trial.targets import cached_target
from rpod_campaign.integrity.campaign import cells, sizes_of
from rpod_campaign.integrity.cell import IntegrityCell
from rpod_campaign.integrity.declared import DeclaredErrors
from rpod_campaign.integrity.faults import BY_NAME, Injector, TurnedTracker, model_of
from rpod_campaign.integrity.options import Options
from rpod_campaign.integrity.report import poisson_interval, sections, share_bound, summarise
from rpod_campaign.integrity.trial import SCHEMA
from rpod_campaign.sequences.cells import document_of
from rpod_campaign.sequences.clocks import Clocks
from rpod_campaign.sequences.course import lidar_of
from rpod_pose.measurement import Measurement
from rpod_pose.ports import Registration
from rpod_schemas.config.estimator import EstimatorSettings, PmdInput
from rpod_schemas.config.estimator.integrity import IntegrityConfig
from rpod_schemas.poses import make_pose
from rpod_schemas.types import LidarScan, Source

POINTS_M = np.array([[0.0, 3.0, 4.0], [np.nan] * 3, [0.0] * 3], np.float32)
SCAN = LidarScan(stamp_ns=100_000_000_000, frame_id="lidar", points_m=POINTS_M)


def measured(fault, size, time_s=7.0):
    injector = Injector(fault, size, start_s=5.0)
    injector.measured(4.0, Measurement("lidar", SCAN.model_copy(update={"stamp_ns": 1}), make_pose()))
    return injector, injector.measured(time_s, Measurement("lidar", SCAN, make_pose()))


def test_a_drift_of_ranges_lengthens_returns_along_their_rays_and_nothing_else():
    _, found = measured("range_drift", 50.0)  # 50 mm/s for 2 s
    np.testing.assert_allclose(found.data.points_m[0], [0.0, 3.06, 4.08], rtol=1e-6)
    assert np.isnan(found.data.points_m[1]).all()
    assert not found.data.points_m[2].any()


def test_both_sensors_have_the_middle_size_of_each_fault():
    assert sizes_of("clock_behind", "both") == (0.05,)
    assert sizes_of("clock_behind", "lidar") == (0.01, 0.05, 0.2)


def test_a_wrong_target_is_a_part_or_another_body_as_large_or_another_shape():
    names = [model_of("mockup", "wrong_target", size) for size in BY_NAME["wrong_target"].sizes]
    assert names == ["hexagonal-body", "random-report-7-2-small@scale=-33%", "mockup@off=94mm"]
    assert model_of("hexagonal-body", "wrong_target", 1.0) == "mockup"
    assert sizes_of("wrong_target", "both") == (2.0,)


def test_a_camera_at_another_rate_is_asked_for_and_counts_its_frames():
    asked = cells(Options(sensor=("lidar",), fault=("none",), rate=45.0))
    assert [each.camera_hz for each in asked] == [45.0]
    table = pl.DataFrame(
        rows(["nominal"] * 90, error_deg=[0.1] * 90, faulty_from=90), schema=SCHEMA | {"trial": pl.Int64}
    )
    hours = [
        summarise(IntegrityCell("none", 0.0, "mockup", "pmd", camera_hz=rate), table)["nominal_hours"]
        for rate in (15.0, 45.0)
    ]
    assert hours == pytest.approx([6.0 / 3600.0, 2.0 / 3600.0])


def test_the_summary_of_a_cell_has_the_documented_keys():
    table = pl.DataFrame(rows(["nominal"] * 3, error_deg=[0.1] * 3), schema=SCHEMA | {"trial": pl.Int64})
    found = summarise(IntegrityCell("none", 0.0, "mockup", "lidar"), table)
    assert found.keys() >= {
        "fault", "target", "sensor", "frames", "misleading", "alerted_share", "time_to_alert_s",
        "false_alerts_per_hour", "availability", "nees_mean", "nees_share_in_95",
    }  # fmt: skip
    assert found["time_to_alert_s"].keys() == {"p50", "p99"}


def test_beside_a_camera_the_lidars_window_holds_the_whole_target():
    document = document_of({"mockup-tumbling": find("mockup-tumbling")}, "both", "mockup", "documented")
    pattern = lidar_of("mockup", document).pattern
    least_m, radius_m = 2.0, cached_target("mockup").radius_m
    half_deg = 0.5 * min(pattern.azimuth_span_deg, pattern.elevation_span_deg)
    assert half_deg > np.rad2deg(np.arcsin(radius_m / least_m))


def test_a_clock_behind_stamps_earlier_and_a_mount_off_turns_the_mount():
    assert measured("clock_behind", 0.05)[1].stamp_ns == SCAN.stamp_ns - 50_000_000
    mount = measured("mount_off", 1.0)[1].T_chaser_sensor
    assert np.rad2deg(mount.rotation.magnitude()) == pytest.approx(1.0)


def test_a_clock_that_is_set_in_a_sequence_is_seen_by_arrivals_and_one_that_was_behind_before_is_not():
    settings = EstimatorSettings(sensors=(PmdInput(),))
    for start, refused in ((40, 9), (0, 0)):
        clocks, found = Clocks(settings, 7, 0), []
        for number in range(80):
            stamp_ns = round((100.0 + number / 15.0 - (0.05 if number >= start else 0.0)) * 1e9)
            found.append(clocks.checked("pmd", stamp_ns, 100.0 + number / 15.0))
        assert sum(each.step is not None for each in found) == refused
        assert [round(each.corrected_s, 2) for each in found if each.corrected_s] == [-0.05] * bool(refused)


def test_a_frozen_stream_repeats_the_last_frame_under_new_stamps_for_its_time():
    injector, found = measured("frozen", 3.0)
    assert (found.stamp_ns, injector.repeats) == (SCAN.stamp_ns, 1)
    assert injector.measured(9.0, Measurement("lidar", SCAN, make_pose())).data is SCAN
    assert injector.repeats == 0


@pytest.mark.parametrize("name", [name for name, fault in BY_NAME.items() if not fault.lasting])
def test_nothing_is_changed_before_the_fault(name):
    before = Measurement("lidar", SCAN, make_pose())
    assert Injector(name, BY_NAME[name].sizes[0], start_s=5.0).measured(4.9, before) is before


def test_a_nominal_run_has_the_declared_errors_and_none_where_none_are_declared():
    exact = {
        "mount_sigma_deg": 0.0,
        "mount_sigma_m": 0.0,
        "clock_sigma_s": 0.0,
        "tuning": {"range_share": 0.0},
    }
    clean = Measurement("lidar", SCAN, make_pose())
    same = DeclaredErrors.drawn(IntegrityConfig(**exact), seed=1, trial=2, sensor="lidar").measured(clean)
    assert same.data.stamp_ns == SCAN.stamp_ns
    np.testing.assert_array_equal(same.data.points_m, POINTS_M)
    drawn = [DeclaredErrors.drawn(IntegrityConfig(), seed=1, trial=k, sensor="pmd") for k in range(400)]
    turns_deg = np.rad2deg([each.of_mount.rotation.as_rotvec() for each in drawn])
    assert turns_deg.std() == pytest.approx(0.02, rel=0.1)
    assert np.std([each.late_s for each in drawn]) == pytest.approx(0.002, rel=0.1)
    assert np.std([each.range_scale for each in drawn]) == pytest.approx(5e-4, rel=0.1)


def test_a_lying_tracker_turns_what_it_measures_from_the_truth():
    class Exact:
        def track(self, _, guess):
            return Registration(Source.LIDAR, T_sensor_target=guess)

    truth, turn = make_pose(translation_m=(0.0, 0.0, 5.0)), Rotation.from_rotvec([np.pi, 0.0, 0.0])
    tracker = TurnedTracker(Exact(), turn)
    assert tracker.track(SCAN, truth).T_sensor_target is truth
    tracker.truth = truth
    found = tracker.track(SCAN, make_pose()).T_sensor_target
    np.testing.assert_allclose(found.as_matrix(), (truth * make_pose(rotation=turn)).as_matrix())


def rows(states, *, error_deg, level_deg=1.0, faulty_from=4, trial=0):
    """Return the rows of a sequence at 1 Hz with an alert limit of 2 deg."""
    found = []
    for number, (state, error) in enumerate(zip(states, error_deg, strict=True)):
        usable = state in ("nominal", "caution")
        found.append(
            dict.fromkeys(SCHEMA)
            | {
                "frame": number, "time_s": float(number), "faulty": number >= faulty_from, "state": state,
                "usable": usable, "attitude_error_deg": error, "position_error_m": 0.01,
                "attitude_level_deg": level_deg, "position_level_m": 0.1, "attitude_limit_deg": 2.0,
                "position_limit_m": 0.2, "harmful": error > 2.0, "misleading": usable and error > level_deg,
                "nees": 6.0, "nees_dof": 6, "seed": 7, "trial": trial,
            }
        )  # fmt: skip
    return found


def test_time_to_alert_runs_from_the_first_error_above_the_limit():
    slow = rows(["nominal"] * 6 + ["alert"] * 2, error_deg=[0.1] * 4 + [1.5, 2.5, 5.0, 9.0])
    never = rows(["nominal"] * 8, error_deg=[0.1] * 4 + [3.0] * 4, trial=1)
    false = rows(["nominal", "alert", "alert", "nominal"] * 2, error_deg=[0.1] * 8, trial=2)
    table = pl.DataFrame([*slow, *never, *false], schema=SCHEMA | {"trial": pl.Int64})
    found = summarise(IntegrityCell("half_turn", 10.0, "mockup", "lidar"), table)
    assert found["time_to_alert_s"] == {"p50": 1.0, "p99": 1.0}
    assert (found["harmed_sequences"], found["alerted_share"]) == (2, 0.5)
    assert (found["misleading"], found["misleading_sequences"]) == (2 + 4, 2)
    assert found["false_alerts"] == 1
    assert found["nominal_hours"] == pytest.approx(12 / 3600)
    assert found["availability"] == 1.0


def test_frames_without_a_track_are_not_available():
    lost = [
        row | dict.fromkeys(("attitude_level_deg", "attitude_limit_deg"), float("nan"))
        for row in rows(["unavailable"] * 4, error_deg=[0.1] * 4)
    ]
    table = pl.DataFrame(
        [*lost, *rows(["nominal"] * 4, error_deg=[0.1] * 4, trial=1)], schema=SCHEMA | {"trial": pl.Int64}
    )
    assert summarise(IntegrityCell("none", 0.0, "mockup", "lidar"), table)["availability"] == 0.5


def test_a_stanford_diagram_has_a_cloud_for_each_target_and_world():
    table = pl.DataFrame(
        rows(["nominal"] * 4, error_deg=[0.1, 0.1, 1.5, 0.1]), schema=SCHEMA | {"trial": pl.Int64}
    )
    results = []
    for target, world in (("mockup", "documented"), ("mockup", "noisy"), ("brick", "documented")):
        cell = IntegrityCell("half_turn", 10.0, target, "lidar", world)
        results.append(CellResult(cell, table, summarise(cell, table)))
    first, *_, frames = sections(results)
    names = ["mockup", "mockup, noisy", "brick"]
    assert [trace.name for trace in first.figures[0].data] == [*names, "level = error", "alert limits"]
    clouds, lines = first.figures[0].data[: len(names)], first.figures[0].data[len(names) :]
    assert {trace.mode for trace in clouds} == {"markers"}
    assert {trace.mode for trace in lines} == {"lines"}
    assert [row[1] for row in frames.tables[0].rows] == names


def test_bounds_of_no_events_are_those_of_the_rule_of_three():
    assert share_bound(0, 3000) == pytest.approx(1e-3, rel=0.01)
    assert share_bound(5, 5) == 1.0
    low, high = poisson_interval(0)
    assert (low, high) == (0.0, pytest.approx(3.69, abs=0.01))
