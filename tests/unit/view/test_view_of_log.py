"""The whole view without a bus: a synthetic log with known errors in, a recording out."""

import numpy as np
import pytest
import rerun as rr
from recordings import blueprints, read_recording
from scipy.spatial import KDTree
from synthetic_log import (
    EPOCH_NS,
    T_CHASER_SENSOR,
    Frame,
    SyntheticRun,
    approach,
    see_depth,
    see_points,
)

from rpod_analysis import open_log
from rpod_analysis.replay.log_view import Part, show_log
from rpod_geometry.wireframe import project, visible_pieces
from rpod_schemas.types import Camera, EstimatorStatus, IntegrityState, Mode
from rpod_target import load_target
from rpod_view.summary import summary
from rpod_view.view import View

CAMERA = Camera(
    width=88, height=72, fx=89.7, fy=89.8, cx=44.4, cy=35.4, distortion=np.array([-0.35, 0.15, 0.0, 0.0, 0.0])
)
"""A quarter of a PMD camera."""
SIGMA_M = (0.01, 0.02, 0.05)
POSITION_M, ATTITUDE_RAD = np.array([0.003, 0.0, 0.004]), np.array([0.0, 0.002, 0.0])


@pytest.fixture(scope="module")
def target():
    return load_target("mockup")


def covariance():
    return np.diag([*np.square(SIGMA_M), *[1e-6] * 3])


def estimated(number, _time_s):
    mode = Mode.ACQUIRING if number < 3 else Mode.TRACKING
    reason = "cost: too high" if number == 8 else ""
    return Frame(mode, ATTITUDE_RAD, POSITION_M, covariance(), reason=reason, integrity=levels(number))


def levels(number):
    state = IntegrityState.UNAVAILABLE if number < 6 else IntegrityState.CAUTION
    level_m = float("nan") if number < 3 else 0.4 if number < 6 else 0.1
    return {
        "state": state,
        "reason": "above the limit" if number < 6 else "a test is near its limit",
        "position_level_m": level_m,
        "position_limit_m": 0.15,
        "attitude_level_deg": 0.5,
        "attitude_limit_deg": 1.0,
    }


def draw(log_path, out, target, *, idle_s=(), **options):
    """Draw a log, then again so long after its end as ``idle_s`` has it, without a message."""
    recording = rr.RecordingStream("rpod")
    recording.save(out)
    options = {"prefix": "estimate", "rate_hz": 10.0} | options
    refused = []
    view = View(recording, target=target, prefix="estimate", reject=lambda *told: refused.append(told))
    with open_log(log_path) as log:
        show_log(log, view, **options)
        for time_s in idle_s:
            view.draw(log.end_ns * 1e-9 + time_s)
    recording.disconnect()
    assert refused == []
    return read_recording(out)


@pytest.fixture(scope="module")
def drawn(tmp_path_factory, target):
    folder = tmp_path_factory.mktemp("view")
    run = SyntheticRun(
        camera=CAMERA,
        target="mockup",
        render=see_depth(target, CAMERA),
        rate_hz=20.0,
        duration_s=1.2,
        frame=estimated,
    )
    log = run.write(folder / "run.mcap")
    return draw(log, folder / "run.rrd", target) | {"path": folder / "run.rrd"}


def time_s(entity):
    return (np.array(entity.stamps_ns) - EPOCH_NS) * 1e-9


def test_images_are_drawn_ten_times_a_second_of_twenty_five_frames(drawn):
    for image in ("depth", "amplitude"):
        stamps_s = time_s(drawn[f"image/pmd/{image}"])
        assert 11 <= len(stamps_s) <= 13
        assert np.diff(stamps_s).min() > 0.0


def test_the_wireframe_lies_where_the_estimate_is(drawn, target):
    entity = drawn["image/pmd/depth/wireframe"]
    strips = dict(zip(entity.stamps_ns, entity.columns["LineStrips2D:strips"], strict=True))
    stamp_ns = max(entity.stamps_ns)
    truth = approach((stamp_ns - EPOCH_NS) * 1e-9)
    at_truth = project(visible_pieces(target, truth), CAMERA).reshape(-1, 2)
    drawn_px = np.array(strips[stamp_ns], float).reshape(-1, 2)
    distance_px, _ = KDTree(at_truth).query(drawn_px)
    assert 0.01 < np.median(distance_px) < 1.0  # the estimate's error of 5 mm and 0.1 deg


def test_without_an_estimate_no_wireframe_is_drawn(drawn):
    first = np.argmin(drawn["image/pmd/depth/wireframe"].stamps_ns)
    assert drawn["image/pmd/depth/wireframe"].columns["LineStrips2D:strips"][first] == []


def test_the_errors_are_those_that_were_put_in(drawn):
    error = drawn["plot/position/error"]
    np.testing.assert_allclose(error.values("Scalars:scalars"), 5.0, atol=1e-3)
    np.testing.assert_allclose(
        drawn["plot/attitude/error"].values("Scalars:scalars"), np.rad2deg(0.002), atol=1e-4
    )
    np.testing.assert_allclose(drawn["plot/position/band"].values("Scalars:scalars"), 150.0, rtol=1e-6)
    assert len(error.stamps_ns) == 22  # each estimate, not only those at which something was drawn


def test_the_ellipsoid_is_three_sigma(drawn):
    half = np.array(drawn["chaser/uncertainty"].values("Ellipsoids3D:half_sizes")[-1])
    np.testing.assert_allclose(np.sort(half), 3.0 * np.array(SIGMA_M), rtol=1e-5)
    inside = np.array(drawn["uncertainty/truth"].values("Points3D:positions")[-1])
    error_m = np.linalg.norm(POSITION_M)
    np.testing.assert_allclose(np.linalg.norm(inside), error_m / 0.15, rtol=1e-2)


def test_truth_and_estimate_stand_at_their_places_at_one_time(drawn):
    truth, estimate = drawn["chaser/truth"], drawn["chaser/estimate"]
    assert truth.stamps_ns == estimate.stamps_ns
    expected = (T_CHASER_SENSOR * approach(time_s(truth)[-1])).translation
    np.testing.assert_allclose(truth.values("Transform3D:translation")[-1], expected, atol=1e-5)
    apart = np.subtract(
        truth.values("Transform3D:translation")[-1], estimate.values("Transform3D:translation")[-1]
    )
    np.testing.assert_allclose(np.linalg.norm(apart), 0.005, atol=1e-4)


def test_points_lie_on_the_target(drawn, target):
    entity = drawn["chaser/pmd/points"]
    last = int(np.argmax(entity.stamps_ns))
    points_m = np.array(entity.columns["Points3D:positions"][last])
    assert 100 < len(points_m) <= 20_000
    pose = approach(time_s(entity)[last])
    assert np.percentile(np.linalg.norm(pose.inv().apply(points_m), axis=1), 90) < target.radius_m


def test_state_and_events_tell_what_changed(drawn):
    assert [row[0] for row in drawn["state/mode"].columns["StateChange:state"]] == ["ACQUIRING", "TRACKING"]
    changes = [row[0] for row in drawn["state/acceptance"].columns["StateChange:state"]]
    assert changes == ["accepted", "rejected", "accepted"]
    events = [row[0] for row in drawn["events"].columns["TextLog:text"]]
    assert [text for text in events if not text.startswith("integrity")] == [
        "ACQUIRING",
        "TRACKING",
        "pmd rejected: cost: too high",
    ]
    assert "integrity CAUTION: a test is near its limit" in events


def test_the_summary_says_what_an_operator_asks_for(drawn):
    texts = [row[0] for row in drawn["summary"].columns["TextDocument:text"]]
    assert texts[0].startswith("# ACQUIRING")
    assert "# TRACKING" in texts[-1]
    assert "| position error | 5.0 mm (3 sigma 150.0) |" in texts[-1]


def test_the_level_stands_around_the_estimate_and_tells_its_state(drawn):
    sphere, estimate = drawn["chaser/level"], drawn["chaser/estimate"]
    half, places = (sphere.columns[f"Ellipsoids3D:{name}"] for name in ("half_sizes", "centers"))
    np.testing.assert_allclose(half[-1][0], 0.1, atol=1e-6)
    np.testing.assert_allclose(places[-1][0], estimate.values("Transform3D:translation")[-1], atol=1e-5)
    levels_mm = drawn["plot/position/level"].values("Scalars:scalars")
    assert np.isnan(levels_mm[:6]).all(), "unknown, or above the alert limit"
    np.testing.assert_allclose(levels_mm[6:], 100.0, rtol=1e-6)
    states = [row[0] for row in drawn["state/integrity"].columns["StateChange:state"]]
    assert states == ["UNAVAILABLE", "CAUTION"]
    table = drawn["summary"].columns["TextDocument:text"][-1][0]
    assert "| integrity | **CAUTION** a test is near its limit |" in table
    assert "| position level | 100.00 mm, limit 150.00 mm |" in table


def test_the_screen_is_divided_once_more_when_the_camera_is_known(drawn):
    assert blueprints(drawn["path"]) == 2


def test_a_slice_of_a_log_at_a_lower_rate(tmp_path, target):
    log = SyntheticRun(duration_s=2.2, truth_rate_hz=50.0, rate_hz=20.0).write(tmp_path / "run.mcap")
    start_ns, end_ns = EPOCH_NS + 10**9, EPOCH_NS + 2 * 10**9
    drawn = draw(log, tmp_path / "run.rrd", target, rate_hz=4.0, part=Part(start_ns, end_ns))
    stamps_s = time_s(drawn["image/pmd/depth"])
    assert 4 <= len(stamps_s) <= 5
    assert 0.9 < stamps_s.min() < stamps_s.max() < 2.0
    assert drawn["chaser/pmd"].stamps_ns, "the mount was told before"


def test_drawing_ends_when_nobody_looks_any_more(tmp_path):
    log = SyntheticRun(duration_s=0.6, truth_rate_hz=50.0).write(tmp_path / "run.mcap")
    moments = iter([True, True, False])
    drawn = draw(log, tmp_path / "run.rrd", None, drawn=lambda: next(moments))
    assert len(drawn["image/pmd/depth"].stamps_ns) == 3


def test_a_lidar_without_truth_and_target_shows_its_points(tmp_path, target):
    run = SyntheticRun(
        kind="lidar", name="lidar", render=see_points(target), rate_hz=5.0, duration_s=1.0, with_truth=False
    )
    drawn = draw(run.write(tmp_path / "run.mcap"), tmp_path / "run.rrd", None)
    assert drawn["chaser/lidar/points"].stamps_ns
    assert "plot/position/error" not in {
        path for path, entity in drawn.items() if "Scalars:scalars" in entity.columns
    }
    assert "chaser/truth/mesh" not in drawn
    assert "3 sigma" in drawn["summary"].columns["TextDocument:text"][-1][0]


def test_without_any_pose_the_scene_is_seen_where_the_points_are(tmp_path, target):
    run = SyntheticRun(
        kind="lidar",
        name="lidar",
        render=see_points(target),
        duration_s=0.5,
        with_truth=False,
        with_estimates=False,
    )
    drawn = draw(run.write(tmp_path / "run.mcap"), tmp_path / "run.rrd", target)
    focus_m = drawn["chaser/focus"].values("Transform3D:translation")[0]
    expected_m = (T_CHASER_SENSOR * approach(0.0)).translation
    assert np.linalg.norm(focus_m - expected_m) < target.radius_m
    assert drawn["summary"].columns["TextDocument:text"][-1][0].startswith("# no estimator")


def tables(drawn):
    return [row[0] for row in drawn["summary"].columns["TextDocument:text"]]


def test_a_silent_estimator_is_told_once_a_second_until_it_speaks(tmp_path):
    run = SyntheticRun(duration_s=5.0, truth_rate_hz=50.0, skipped=lambda number: 10 < number < 45)
    drawn = draw(run.write(tmp_path / "run.mcap"), tmp_path / "run.rrd", None)
    told = [table.partition("\n\n")[::2] for table in tables(drawn) if "no status" in table]
    assert {heading for heading, _ in told} == {"# TRACKING"}
    assert [text.split("\n")[0] for _, text in told] == [f"**no status for {k} s**" for k in (2, 3)]
    assert "no status" not in tables(drawn)[-1]


def test_without_messages_only_the_silence_is_drawn(tmp_path):
    log = SyntheticRun(duration_s=0.5, truth_rate_hz=50.0).write(tmp_path / "run.mcap")
    once = draw(log, tmp_path / "once.rrd", None)
    idle = draw(log, tmp_path / "idle.rrd", None, idle_s=np.arange(0.0, 4.05, 0.1))
    more = {path: len(entity.stamps_ns) - len(once[path].stamps_ns) for path, entity in idle.items()}
    tables_more = more.pop("summary")
    assert not any(more.values()), more
    assert tables_more in (2, 3)
    assert "**no status for 4 s**" in tables(idle)[-1]


def test_the_point_of_the_truth_goes_with_the_truth(tmp_path):
    run = SyntheticRun(duration_s=1.0, truth_rate_hz=50.0, truth_gaps_s=((0.5, 9.0),), frame=estimated)
    drawn = draw(run.write(tmp_path / "run.mcap"), tmp_path / "run.rrd", None)
    truth, ellipsoid = drawn["uncertainty/truth"], drawn["uncertainty/ellipsoid"]
    assert truth.stamps_ns == ellipsoid.stamps_ns
    points, ellipsoids = truth.columns["Points3D:positions"], ellipsoid.columns["Ellipsoids3D:half_sizes"]
    assert 1 <= len(points) < len(ellipsoids) - 3


@pytest.mark.parametrize(
    ("changes", "shown"),
    [
        ({}, "-"),
        ({"sensor": "pmd", "accepted": True}, "accepted"),
        ({"sensor": "pmd"}, "rejected: -"),
        ({"sensor": "pmd", "reason": "|cost| too high"}, "rejected: /cost/ too high"),
    ],
)
def test_the_table_says_what_became_of_the_measurement(changes, shown):
    status = EstimatorStatus(stamp_ns=1, frame_id="chaser", mode=Mode.COASTING, **changes)
    assert f"| measurement | {shown} |\n" in summary(status, None, ())
