"""The benchmark of registration packages, with peers that are none: no package of theirs is needed."""

import json
import sys
from dataclasses import asdict, replace
from io import StringIO

import numpy as np
import pytest
from rich.console import Console
from scipy.spatial.transform import RigidTransform, Rotation

from peers.benchmark import START_DEG, START_M, Case, Outcome, Peer, Scene, Task, cases, disturbed, run, score
from peers.camera import PMD, STARTS, CameraScene, camera_cases
from peers.table import table
from rpod_schemas.config.lidar import LidarConfig
from rpod_schemas.poses import make_pose, pose_error
from rpod_schemas.types import LidarScan
from rpod_target import load_target

TRUTH = make_pose(rotation=Rotation.from_rotvec([0.4, -0.2, 1.0]), translation_m=[0.0, 0.0, 30.0])
SCAN = LidarScan(stamp_ns=0, frame_id="lidar", points_m=np.zeros((1, 3), np.float32))


def turned(angle_deg: float) -> RigidTransform:
    return make_pose(
        rotation=TRUTH.rotation * Rotation.from_rotvec([0.0, np.deg2rad(angle_deg), 0.0]),
        translation_m=TRUTH.translation,
    )


def fake(*answers: RigidTransform | None, task: Task = Task.TRACKING) -> Peer[Scene, LidarScan]:
    """Return a peer that gives these answers in turn."""
    turn = iter(answers)
    return Peer("fake", "none", task, "gives what it is told to", lambda _: lambda _scan, _start: next(turn))


def outcomes_of(peer: Peer[Scene, LidarScan], count: int, **changes) -> list[Outcome]:
    scene = Scene(load_target("envisat-bulky"), LidarConfig(), 20.0)
    return run(peer.build(scene), [Case(SCAN, TRUTH, TRUTH)] * count, **{"finish": None, **changes})


def test_a_peer_is_scored_by_the_attitudes_that_are_right():
    peer = fake(turned(0.0), turned(1.0), turned(2.9), turned(3.1), turned(180.0), None)
    scored = score(peer, outcomes_of(peer, 6), range_m=20.0)
    assert (scored.trials, scored.no_pose) == (6, 1)
    assert scored.success_rate == 0.5
    assert scored.median_error_deg == pytest.approx(1.0)
    assert scored.wilson_low == pytest.approx(0.1876, abs=1e-4)
    assert scored.wilson_high == pytest.approx(0.8124, abs=1e-4)
    assert scored.median_s >= 0.0


def test_a_peer_without_a_success_has_no_median_error():
    peer = fake(None, turned(90.0))
    scored = score(peer, outcomes_of(peer, 2), range_m=20.0)
    assert scored.success_rate == 0.0
    assert scored.median_error_deg is None


def test_the_last_icp_refines_what_was_found_and_is_not_asked_without_a_pose():
    asked: list[RigidTransform] = []

    def finish(_: LidarScan, pose: RigidTransform) -> RigidTransform:
        asked.append(pose)
        return TRUTH

    peer = fake(turned(10.0), None, task=Task.ACQUISITION)
    first, second = outcomes_of(peer, 2, finish=finish)
    assert first.error_deg == pytest.approx(0.0, abs=1e-9)
    assert second.error_deg is None
    assert len(asked) == 1


def test_every_peer_sees_the_same_trials():
    scene = Scene(load_target("envisat-bulky"), LidarConfig(), 50.0)
    one, other = (list(cases(scene, seed=3, trials=3)) for _ in range(2))
    for first, second in zip(one, other, strict=True):
        np.testing.assert_array_equal(first.view.points_m, second.view.points_m)
        np.testing.assert_array_equal(first.start.as_matrix(), second.start.as_matrix())
        assert first.truth.translation.tolist() == [0.0, 0.0, 50.0]
    assert not np.allclose(one[0].truth.as_matrix(), one[1].truth.as_matrix())
    assert scene.spacing_m == pytest.approx(0.873, abs=1e-3)


def test_tracking_starts_as_far_off_as_is_said():
    attitude_rad, position_m = pose_error(TRUTH, disturbed(TRUTH, np.random.default_rng(1)))
    assert np.rad2deg(np.linalg.norm(attitude_rad)) == pytest.approx(START_DEG)
    assert np.linalg.norm(position_m) == pytest.approx(START_M)


def test_scores_are_shown_as_a_table_and_as_json():
    peer = fake(turned(1.0), None)
    first = score(peer, outcomes_of(peer, 2), range_m=20.0)
    rows = [first, replace(first, task=Task.ACQUISITION, median_error_deg=None)]
    console = Console(width=140, record=True, file=StringIO())
    console.print(table(rows, title="fake"))
    shown = console.export_text()
    assert "0.500" in shown
    assert "0.095 to 0.905" in shown
    assert json.loads(json.dumps([asdict(row) for row in rows]))[1]["task"] == "acquisition"


def test_the_benchmark_itself_needs_no_peers_package():
    assert "small_gicp" not in sys.modules
    assert not any(
        name.startswith("peers.") and name not in {"peers.benchmark", "peers.camera", "peers.table"}
        for name in sys.modules
    )


def test_a_camera_frame_is_a_success_by_attitude_and_position():
    assert PMD.criterion.met(Outcome(3.9, 0.079, 0.1))
    assert not PMD.criterion.met(Outcome(4.1, 0.01, 0.1))
    assert not PMD.criterion.met(Outcome(1.0, 0.081, 0.1))
    assert not PMD.criterion.met(Outcome(None, None, 0.1))
    scored = score(fake(), [Outcome(1.0, 0.02, 0.1), Outcome(1.0, 0.5, 0.1)], clouds=PMD, start="2 deg, 3 cm")
    assert (scored.clouds, scored.range_m, scored.start) == ("pmd", None, "2 deg, 3 cm")
    assert (scored.success_rate, scored.median_error_m) == (0.5, 0.02)


def test_every_start_is_tried_on_the_same_camera_frames():
    near, far = (
        list(camera_cases(CameraScene(load_target("mockup"), *start), seed=3, trials=2))
        for start in (STARTS[0], STARTS[-1])
    )
    for one, other in zip(near, far, strict=True):
        np.testing.assert_array_equal(one.view.frame.depth_m, other.view.frame.depth_m)
        attitude_rad, position_m = pose_error(one.truth, other.start)
        assert np.rad2deg(np.linalg.norm(attitude_rad)) == pytest.approx(20.0)
        assert np.linalg.norm(position_m) == pytest.approx(0.5)
        # points of the surface, in the sensor's axes
        points_m = one.truth.inv().apply(one.view.returns_m.astype(np.float64))
        assert 300 < len(points_m) < 20_000
        assert np.median(np.abs(points_m[:, 0])) < 0.3
