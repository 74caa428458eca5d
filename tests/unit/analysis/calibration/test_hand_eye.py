"""Mount, holder and clock from stamped poses: what was put in is found, and what is not known is told."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from rpod_analysis.calibration.hand_eye.fit import fit_hand_eye
from rpod_analysis.calibration.hand_eye.parameters import (
    DEPTH,
    DRIFT,
    HOLDER_M,
    HOLDER_RAD,
    MOUNT_M,
    MOUNT_RAD,
    OFFSET,
    Assumptions,
)
from rpod_analysis.calibration.hand_eye.poses import StampedPoses
from rpod_analysis.errors import CalibrationError

EPOCH_NS = 1_767_225_600_000_000_000
RECORDED = Path(__file__).parent / "prime_sense"
AXES = np.eye(3)


class Laboratory:
    """A minute of a swaying target, seen at 45 Hz and known at 250 Hz, with errors that are put in."""

    def __init__(self, seed, *, duration_s=60.0, turning=AXES, truth=(2e-4, 0.01), offset_s=0.013, **changes):
        self.generator = np.random.default_rng(seed)
        self.turning, self.duration_s = turning, duration_s
        self.X = Rotation.from_rotvec(self.generator.normal(0.0, 0.1, 3))
        self.t_X = self.generator.normal(0.0, 0.3, 3)
        self.Y = Rotation.random(rng=self.generator)
        self.t_Y = self.generator.normal(0.0, 0.1, 3)
        self.offset_s, self.drift = offset_s, 20e-6
        self.depth_m = changes.get("depth_m", 0.0)
        self.lasting_s = changes.get("lasting_s", 0.0)
        self.truth = self.of_truth(*truth)
        self.measured = self.of_sensor(1e-3, 0.1)

    def motion(self, time_s):
        """Return T_chaser_holder."""
        sines = np.column_stack([np.sin(0.3 * time_s), np.sin(0.5 * time_s + 1), np.sin(0.41 * time_s + 2)])
        position_m = np.column_stack(
            [0.2 * np.sin(0.6 * time_s), 0.2 * np.sin(0.45 * time_s + 1), 3 + 0.8 * np.sin(0.25 * time_s)]
        )
        return Rotation.from_rotvec(np.radians(40.0) * sines @ self.turning), position_m

    def noise(self, number, sigma, step_s):
        white = sigma * self.generator.standard_normal((number, 3))
        kept = np.exp(-step_s / self.lasting_s) if self.lasting_s else 0.0
        white[1:] *= np.sqrt(1.0 - kept**2)
        return lfilter([1.0], [1.0, -kept], white, axis=0)

    def stamped(self, time_s, R, t_m, sigma_m, sigma_deg):
        covariance = np.diag([sigma_m**2] * 3 + [np.radians(sigma_deg) ** 2] * 3)
        stamp_ns = EPOCH_NS + np.round(1e9 * time_s).astype(np.int64)
        return StampedPoses(stamp_ns, R.as_matrix(), t_m, np.tile(covariance, (time_s.size, 1, 1)))

    def of_truth(self, sigma_m, sigma_deg):
        time_s = np.arange(-1.0, self.duration_s + 1.0, 1 / 250.0)
        R, t_m = self.motion(time_s)
        turn = Rotation.from_rotvec(self.noise(time_s.size, np.radians(sigma_deg), 0.004))
        return self.stamped(
            time_s, turn * R, t_m + self.noise(time_s.size, sigma_m, 0.004), sigma_m, sigma_deg
        )

    def of_sensor(self, sigma_m, sigma_deg):
        time_s = np.arange(0.0, self.duration_s, 1 / 45.0)
        R, t_m = self.motion(time_s)
        seen = self.X.inv() * R * self.Y
        at_m = self.X.inv().apply(R.apply(self.t_Y) + t_m - self.t_X)
        at_m *= 1.0 + self.depth_m / np.linalg.norm(at_m, axis=1, keepdims=True)
        turn = Rotation.from_rotvec(self.noise(time_s.size, np.radians(sigma_deg), 1 / 45.0))
        stamps_s = time_s + self.offset_s + self.drift * (time_s - 0.5 * self.duration_s)
        return self.stamped(
            stamps_s, turn * seen, at_m + self.noise(time_s.size, sigma_m, 1 / 45.0), sigma_m, sigma_deg
        )

    def wrong(self, found):
        """Return found minus put in, shape (15,)."""
        state, wrong = found.state, np.zeros(15)
        wrong[MOUNT_M], wrong[HOLDER_M] = state.t_X - self.t_X, state.t_Y - self.t_Y
        wrong[MOUNT_RAD] = (Rotation.from_matrix(state.R_X) * self.X.inv()).as_rotvec()
        wrong[HOLDER_RAD] = (Rotation.from_matrix(state.R_Y) * self.Y.inv()).as_rotvec()
        wrong[OFFSET], wrong[DRIFT] = state.offset_s - self.offset_s, state.drift - self.drift
        wrong[DEPTH] = state.depth_m - self.depth_m
        return wrong


def fitted(laboratory, **known):
    return fit_hand_eye(laboratory.measured, laboratory.truth, Assumptions(**known))


@cache
def errors_of(seeds, **changes):
    laboratories = [Laboratory(seed, **changes) for seed in seeds]
    found = [fitted(laboratory) for laboratory in laboratories]
    wrong = np.array([laboratory.wrong(each) for laboratory, each in zip(laboratories, found, strict=True)])
    sigma = np.array([np.sqrt(np.diag(each.covariance)) for each in found])
    return wrong, sigma[:, :DEPTH]


def rms(values):
    return float(np.sqrt(np.mean(np.sum(values**2, axis=-1))))


def test_a_minute_with_a_good_truth_tells_mount_and_clock_to_the_aim_and_says_how_well():
    wrong, sigma = errors_of((0, 1, 2))
    assert rms(wrong[:, MOUNT_M]) < 0.3e-3
    assert np.degrees(rms(wrong[:, MOUNT_RAD])) < 0.02
    assert rms(wrong[:, [OFFSET]]) < 0.2e-3
    normalised = wrong[:, :DEPTH] / sigma
    assert 0.4 < np.sqrt(np.mean(normalised**2)) < 1.5


def test_errors_that_last_widen_what_is_stated():
    wrong, sigma = errors_of((0, 1), lasting_s=0.3)
    independent = errors_of((0, 1, 2))[1][:2]
    assert np.median(sigma / independent) > 2.0
    assert np.sqrt(np.mean((wrong[:, :DEPTH] / sigma) ** 2)) < 2.0


def test_the_truth_of_the_paper_tells_the_clock_within_half_a_millisecond():
    wrong, sigma = errors_of((0, 1), truth=(1.56e-3, 0.2))
    assert rms(wrong[:, [OFFSET]]) < 0.5e-3
    assert rms(wrong[:, MOUNT_M]) < 1e-3
    assert (sigma[:, OFFSET] > errors_of((0, 1, 2))[1][:2, OFFSET]).all()


def test_a_clock_that_is_seconds_ahead_is_found():
    laboratory = Laboratory(5, offset_s=7.3, duration_s=40.0)
    found = fitted(laboratory)
    assert found.state.offset_s == pytest.approx(7.3, abs=1e-3)
    assert found.outliers < 0.01 * found.pairs


def test_a_turn_about_one_axis_is_refused_in_words_that_say_what_is_missing():
    laboratory = Laboratory(2, duration_s=20.0, turning=np.outer([1.0, 1.0, 1.0], [0.0, 0.0, 1.0]))
    with pytest.raises(CalibrationError, match=r"about one axis.*1\.00.*Turn it about a second axis"):
        fitted(laboratory)


def test_a_target_that_does_not_turn_is_refused():
    laboratory = Laboratory(2, duration_s=20.0, turning=np.zeros((3, 3)))
    with pytest.raises(CalibrationError, match=r"turned by .* only.*two axes"):
        fitted(laboratory)


def test_a_mount_that_is_kept_leaves_the_clock_to_be_found_from_one_axis():
    laboratory = Laboratory(2, duration_s=20.0, turning=np.outer([1.0, 1.0, 1.0], [0.0, 0.0, 1.0]))
    found = fitted(laboratory, mount=(laboratory.X.as_matrix(), laboratory.t_X))
    assert laboratory.wrong(found)[OFFSET] == pytest.approx(0.0, abs=4.0 * found.offset_sigma_s)
    assert found.offset_sigma_s < 1e-3
    assert not found.covariance[:6].any()


def test_wrong_poses_do_not_move_the_result():
    laboratory = Laboratory(3, duration_s=30.0)
    expected = fitted(laboratory)
    spoilt = np.random.default_rng(1).random(len(laboratory.measured)) < 0.1
    measured = laboratory.measured
    R, t_m = measured.R.copy(), measured.t_m.copy()
    R[spoilt] = Rotation.random(int(spoilt.sum()), rng=1).as_matrix()
    t_m[spoilt] += 0.5
    found = fit_hand_eye(replace(measured, R=R, t_m=t_m), laboratory.truth)
    assert found.outliers == spoilt.sum()
    np.testing.assert_allclose(found.state.t_X, expected.state.t_X, atol=0.5e-3)


def test_depth_offset_and_mount_along_the_boresight_are_told_to_be_confounded():
    laboratory = Laboratory(4, depth_m=0.01, duration_s=30.0)
    found = fitted(laboratory, depth_sigma_m=0.02)
    assert found.depth_correlation > 0.95
    along = found.state.R_X[:, 2]
    sigma_m = np.sqrt(along @ found.covariance[MOUNT_M, MOUNT_M] @ along)
    assert abs(along @ laboratory.wrong(found)[MOUNT_M]) < 4.0 * sigma_m
    assert found.boresight_sigma_m < 0.3 * sigma_m


def test_poses_without_truth_around_them_are_counted():
    laboratory = Laboratory(6, duration_s=20.0)
    late = laboratory.truth.at(laboratory.truth.stamp_ns > EPOCH_NS + 5_000_000_000)
    found = fit_hand_eye(laboratory.measured, late)
    assert found.unused == pytest.approx(5 * 45, abs=10)


def recorded(file):
    """Return the inverse of recorded poses: of the room in the moving body."""
    rows = np.loadtxt(RECORDED / file, delimiter=",")
    R = Rotation.from_quat(rows[:, 4:]).inv()
    stamp_ns = np.round(1e9 * rows[:, 0]).astype(np.int64)
    return StampedPoses(stamp_ns, R.as_matrix(), -R.apply(rows[:, 1:4]), np.zeros((len(rows), 6, 6)))


def test_thirty_recorded_seconds_give_the_mount_of_the_whole_recording():
    found = fit_hand_eye(recorded("camera.csv"), recorded("vicon.csv"))
    whole_m, whole = [0.0755, 0.0416, 0.0246], Rotation.from_quat([-0.4167, 0.3643, -0.5675, 0.6096])
    apart = np.degrees((Rotation.from_matrix(found.state.R_X) * whole.inv()).magnitude())
    assert np.linalg.norm(found.state.t_X - whole_m) < 3.0 * found.worst(MOUNT_M)[0] + 2e-3
    assert apart < 3.0 * np.degrees(found.worst(MOUNT_RAD)[0]) + 0.15
    assert found.state.offset_s == pytest.approx(-0.0166, abs=4.0 * found.offset_sigma_s)
    assert found.offset_sigma_s < 5e-3
