"""Handovers between sensors: their gap, and the jump of the error."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_analysis.scoring.handover import Handovers, beyond
from rpod_analysis.scoring.score import NEES_95

SECOND_NS = 1_000_000_000


def run(frames, *, jump_m=0.0, jump_deg=0.0, at_s=5.0, scored=True, sigma=1e-9):
    """A minute of frames (stamp, s; sensor; accepted) with an estimate each, whose error jumps at a time."""
    stamp_ns = np.array([round(time_s * SECOND_NS) for time_s, _, _ in frames])
    time_s = stamp_ns / SECOND_NS
    truth_m = np.column_stack([0.3 * time_s, np.zeros_like(time_s), 20.0 - time_s])
    moved = time_s >= at_s
    turn = Rotation.from_rotvec(np.deg2rad(jump_deg) * moved[:, None] * [0.0, 1.0, 0.0])
    spin = Rotation.from_rotvec(0.1 * time_s[:, None] * [1.0, 0.0, 0.0])
    places_m = truth_m + jump_m * moved[:, None] * [0.0, 0.0, 1.0]
    return SimpleNamespace(
        statuses=SimpleNamespace(
            accepted=np.array([each[2] for each in frames]),
            sensor=np.array([each[1] for each in frames]),
            stamp_ns=stamp_ns,
        ),
        estimates=SimpleNamespace(
            stamp_ns=stamp_ns, poses=RigidTransform.from_components(places_m, turn * spin)
        ),
        covariance=np.tile(sigma**2 * np.eye(6), (len(frames), 1, 1)),
        T_truth=RigidTransform.from_components(truth_m, spin),
        errors=SimpleNamespace(scored=np.full(len(frames), scored)),
    )


LIDAR = [(float(second), "lidar", True) for second in range(6)]
CAMERA = [(5.0 + 0.1 * number, "pmd", True) for number in range(1, 20)]


def of(*runs):
    found = Handovers()
    for each in runs:
        found.take(each)
    return found.summary()


def test_a_camera_that_takes_over_from_a_lidar_is_a_handover_with_gap_and_jump():
    found = of(run([*LIDAR, *CAMERA], jump_m=0.02, jump_deg=0.5, at_s=5.05))
    assert (found.count, found.gap_s) == (1, pytest.approx(0.1))
    assert (found.jump_m, found.jump_deg) == (pytest.approx(0.02), pytest.approx(0.5, abs=1e-4))


def test_a_jump_is_what_is_beyond_the_covariance_of_the_estimate_before():
    found = of(run([*LIDAR, *CAMERA], jump_m=0.02, jump_deg=0.5, at_s=5.05, sigma=0.005))
    assert (found.change_m, found.change_deg) == (pytest.approx(0.02), pytest.approx(0.5, abs=1e-4))
    assert found.jump_m == pytest.approx(0.02 - 0.005 * np.sqrt(NEES_95[3]), rel=1e-6)
    assert found.jump_deg == 0.0, "0.5 deg lie within an uncertainty of 0.3 deg"


def test_a_change_is_compared_with_the_covariance_along_its_own_direction():
    covariance = np.diag([1.0, 0.01, 0.01]) ** 2
    assert beyond(np.array([2.0, 0.0, 0.0]), covariance) == 0.0
    assert beyond(np.array([0.0, 2.0, 0.0]), covariance) == pytest.approx(2.0 - 0.01 * np.sqrt(NEES_95[3]))
    assert beyond(np.zeros(3), covariance) == 0.0


def test_the_minutes_of_a_run_give_the_same():
    whole = of(run([*LIDAR, *CAMERA], jump_m=0.02, at_s=5.05))
    assert of(run(LIDAR), run(CAMERA, jump_m=0.02, at_s=5.05)) == whole


def test_a_jump_before_the_last_scan_is_none_of_the_handover():
    assert of(run([*LIDAR, *CAMERA], jump_m=0.02, at_s=3.0)).jump_m == pytest.approx(0.0, abs=1e-9)


def test_frames_that_are_not_accepted_hand_nothing_over():
    assert of(run([*LIDAR, *((time_s, name, False) for time_s, name, _ in CAMERA)])) is None


def test_two_sensors_that_both_deliver_hand_over_once():
    both = sorted([*LIDAR, *((number + 0.5, "pmd", True) for number in range(6))])
    assert of(run(both)).count == 1


def test_one_sensor_has_no_handover():
    assert of(run(LIDAR)) is None


def test_without_truth_the_gap_is_known_and_the_jump_is_not():
    found = of(run([*LIDAR, *CAMERA], scored=False))
    assert (found.gap_s, found.jump_m, found.jump_deg) == (pytest.approx(0.1), None, None)
