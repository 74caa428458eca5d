"""Depth before the methods: unwrapped, calibrated, or refused by the field that is wrong."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pmd_frames import CAMERA, depth_frame, frame_of, strange_frames
from scipy.spatial.transform import Rotation

from rpod_geometry.rays import RayGrid
from rpod_pose.methods import methods_of
from rpod_pose.pmd.depth_preparation import (
    DepthPreparation,
    PreparedAcquirer,
    PreparedTracker,
    calibrated,
    unwrap,
)
from rpod_pose.ports import Acquisition, Outcome, Registration
from rpod_schemas.config.estimator import PmdInput
from rpod_schemas.config.pmd.depth_calibration import DepthCalibration, Harmonic, unambiguous_range_m
from rpod_schemas.poses import make_pose, pose_error
from rpod_schemas.types import PmdInfo, Source
from rpod_target import load_target
from rpod_target.equivalence import Symmetry

MHZ_20, MHZ_30 = 20.013e6, 30e6
OBLIQUE = Rotation.from_euler("ZYX", [12.0, 65.0, 5.0], degrees=True)
LENS = CAMERA.model_copy(update={"distortion": np.array([-0.35, 0.15, 0.001, -0.002, 0.0])})
WIGGLING = DepthCalibration(
    modulation_frequency_hz=(MHZ_20,),
    offset_m=0.03,
    harmonics=(
        Harmonic(modulation_frequency_hz=MHZ_20, order=4, cos_m=0.004, sin_m=-0.0358),
        Harmonic(modulation_frequency_hz=MHZ_20, order=8, cos_m=0.001, sin_m=0.002),
    ),
)
PLAIN = PmdInput(unwrapping="none")


@pytest.fixture(scope="module")
def target():
    return load_target("mockup")


def info(*hertz):
    return PmdInfo(
        modulation_frequency_hz=np.array(hertz),
        integration_time_s=0.016,
        electrons_per_count=40.0,
        saturation_count=3750.0,
    )


def seen_by(frame, *hertz, calibration=None):
    """Return an ideal frame as a camera with an error measures it, modulo its unambiguous range."""
    rays = RayGrid.pinhole(frame.camera).components[2]
    distance_m = frame.depth_m / rays
    if calibration is not None:
        distance_m = distance_m + calibration.error_m(distance_m)
    if len(hertz) == 1:
        distance_m = distance_m % unambiguous_range_m(hertz[0])
    depth_m = (distance_m * rays).astype(np.float32)
    return frame.model_copy(update={"depth_m": depth_m, "info": info(*hertz) if hertz else None})


def pose_at(range_m):
    return make_pose(rotation=OBLIQUE, translation_m=[0.1, -0.05, range_m])


# --- calibration ---


@given(st.floats(0.5, 29.0))
def test_a_calibration_undoes_the_error_that_it_describes(true_m):
    true = np.array([true_m])
    np.testing.assert_allclose(calibrated(WIGGLING, true + WIGGLING.error_m(true)), true, atol=1e-9)


def test_the_error_is_taken_off_along_the_rays_of_a_distorted_lens(target):
    ideal = depth_frame(target, pose_at(3.0), camera=LENS)
    wrong = seen_by(ideal, MHZ_20, calibration=WIGGLING)
    assert np.nanmax(np.abs(wrong.depth_m - ideal.depth_m)) > 0.02
    prepared = DepthPreparation(PmdInput(calibration=WIGGLING), target).predicted(wrong, pose_at(3.0))
    np.testing.assert_allclose(prepared.depth_m, ideal.depth_m, atol=2e-4)


def test_a_calibrated_camera_measures_the_range_without_its_bias(target):
    frame = seen_by(depth_frame(target, pose_at(5.2), noise_m=0.01), MHZ_20, calibration=WIGGLING)

    def error_m(sensor):
        found = methods_of(sensor, target).tracker.track(frame, pose_at(5.2)).T_sensor_target
        return abs(pose_error(pose_at(5.2), found)[1][2])

    assert error_m(PmdInput()) > 0.012
    assert error_m(PmdInput(calibration=WIGGLING)) < 0.01


def test_pixels_without_depth_stay_as_they_are(target):
    depth_m = np.full((CAMERA.height, CAMERA.width), np.nan, np.float32)
    depth_m[0, :4] = 0.0, -1.0, np.inf, 40.0
    preparation = DepthPreparation(PmdInput(calibration=WIGGLING, unwrapping="none"), target)
    prepared = preparation.predicted(frame_of(depth_m), pose_at(4.0)).depth_m
    np.testing.assert_array_equal(prepared[0, :3], [0.0, -1.0, np.inf])
    assert prepared[0, 3] == pytest.approx(40.0, abs=0.1)
    assert np.isnan(prepared[1:]).all()


def test_a_frame_is_left_alone_and_not_copied_where_there_is_nothing_to_do(target):
    frame = depth_frame(target, pose_at(4.0))
    assert DepthPreparation(PmdInput(), target).predicted(frame, pose_at(4.0)) is frame
    known = frame.model_copy(update={"info": info(MHZ_20)})
    assert DepthPreparation(PLAIN, target).predicted(known, pose_at(4.0)) is known


# --- unwrapping ---


@pytest.mark.parametrize("hertz", [MHZ_20, MHZ_30])
@pytest.mark.parametrize("range_m", [4.9, 7.0, 7.5, 10.0])
def test_a_wrapped_target_is_put_where_it_is_predicted(target, hertz, range_m):
    ideal = depth_frame(target, pose_at(range_m))
    wrapped = seen_by(ideal, hertz)
    assert range_m < 5.0 or np.nanmax(np.abs(wrapped.depth_m - ideal.depth_m)) > 4.0
    guess = make_pose(rotation=OBLIQUE, translation_m=[0.3, 0.1, range_m - 0.3])
    prepared = DepthPreparation(PmdInput(), target).predicted(wrapped, guess)
    np.testing.assert_allclose(prepared.depth_m, ideal.depth_m, atol=1e-4)


def test_background_that_is_nowhere_near_the_target_is_not_moved(target):
    frame = seen_by(depth_frame(target, pose_at(4.0)), MHZ_20)
    frame.depth_m[:20] = 3.0
    prepared = DepthPreparation(PmdInput(), target).predicted(frame, pose_at(9.0))
    np.testing.assert_allclose(prepared.depth_m[:20], 3.0, atol=1e-6)


def test_a_camera_of_two_frequencies_has_unwrapped_by_itself(target):
    frame = seen_by(depth_frame(target, pose_at(10.0)), MHZ_20, MHZ_30)
    prepared = DepthPreparation(PmdInput(), target).predicted(frame, pose_at(3.0))
    np.testing.assert_array_equal(prepared.depth_m, frame.depth_m)


def test_the_frequency_may_come_from_the_configuration_or_from_the_calibration(target):
    ideal = depth_frame(target, pose_at(9.0))
    silent = seen_by(ideal, MHZ_20).model_copy(update={"info": None})
    faultless = DepthCalibration(modulation_frequency_hz=(MHZ_20,))
    sources = {"modulation_frequency_hz": (MHZ_20,)}, {"calibration": faultless}
    for source in sources:
        prepared = DepthPreparation(PmdInput(**source), target).predicted(silent, pose_at(9.0))
        np.testing.assert_allclose(prepared.depth_m, ideal.depth_m, atol=1e-3)


@pytest.mark.parametrize("hertz", [MHZ_20, MHZ_30])
def test_an_approach_from_10_m_to_5_m_is_tracked_through_the_wrap(target, hertz):
    tracker = methods_of(PmdInput(), target).tracker
    guess = pose_at(10.1)
    for range_m in np.arange(10.0, 4.9, -0.25):
        frame = seen_by(depth_frame(target, pose_at(range_m), noise_m=0.01), hertz)
        found = tracker.track(frame, guess)
        assert not found.belief.reason
        attitude_rad, position_m = pose_error(pose_at(range_m), found.T_sensor_target)
        assert np.linalg.norm(attitude_rad) < np.radians(4.0), range_m
        assert np.linalg.norm(position_m) < 0.08, range_m
        guess = make_pose(translation_m=[0.0, 0.0, -0.2]) * found.T_sensor_target


@pytest.mark.parametrize(("yaw_deg", "range_m"), [(70.0, 9.0), (70.0, 10.0), (-70.0, 9.0)])
def test_a_body_longer_than_the_unambiguous_range_is_tracked(yaw_deg, range_m):
    stage = load_target("rocket-stage")
    attitude = Rotation.from_euler("ZYX", [12.0, yaw_deg, 5.0], degrees=True)
    pose = make_pose(rotation=attitude, translation_m=[0.1, -0.05, range_m])
    noisy = depth_frame(stage, pose, noise_m=0.01)
    frame = seen_by(noisy, MHZ_20)
    assert np.count_nonzero((frame.depth_m > 3.6) & (frame.depth_m < 5.0)) > 100  # its far end, in the sphere
    prepared = DepthPreparation(PmdInput(), stage).predicted(frame, pose)
    np.testing.assert_allclose(prepared.depth_m, noisy.depth_m, atol=1e-4)
    found = methods_of(PmdInput(), stage).tracker.track(frame, pose)
    assert not found.belief.reason
    attitude_rad, position_m = pose_error(pose, found.T_sensor_target)
    assert np.linalg.norm(attitude_rad) < np.radians(0.2)
    assert np.linalg.norm(position_m) < 0.01


def test_a_distance_is_wrapped_where_all_its_phases_are_the_expected_ones():
    first_m, second_m = unambiguous_range_m(MHZ_20), unambiguous_range_m(MHZ_30)
    short_m = np.array([0.1, first_m + 0.1, first_m + 0.6, -first_m, 2.0 * first_m, np.nan, np.inf])
    assert abs(2.0 * first_m - 3.0 * second_m) < 0.1
    depth_m, cosine = np.full((1, 7), 8.0, np.float32), np.full((1, 7), 0.8, np.float32)
    shown_m = (depth_m / cosine + short_m).astype(np.float32)
    shifted_m = {MHZ_20: [0, first_m, 0, 0, 2 * first_m, 0, 0], MHZ_30: [0, 0, 0, 0, 2 * first_m, 0, 0]}
    for highest, expected_m in shifted_m.items():
        intervals_m = np.array([unambiguous_range_m(hertz) for hertz in sorted({MHZ_20, highest})])
        out_m = np.empty_like(depth_m)
        unwrap(depth_m, cosine, shown_m, intervals_m, out_m)
        np.testing.assert_allclose(out_m - depth_m, 0.8 * np.array([expected_m]), atol=1e-5)


def test_pixels_without_depth_keep_their_values_where_distances_are_unwrapped():
    depth_m = np.array([[np.nan, -0.1, 0.0]], np.float32)
    out_m, ones = np.empty_like(depth_m), np.ones_like(depth_m)
    unwrap(depth_m, ones, np.full_like(depth_m, 9.0), np.array([7.0, 5.0]), out_m)
    np.testing.assert_array_equal(out_m, depth_m)


class Listener:
    """An acquirer that finds the target where it is at the true distance alone."""

    def __init__(self, true_m):
        self.true_m, self.tried_m = true_m, []

    def acquire(self, frame):
        seen_m = float(np.nanmedian(frame.depth_m))
        self.tried_m.append(seen_m)
        if abs(seen_m - self.true_m) < 1.0:
            return Acquisition(Registration(Source.PMD_DEPTH, make_pose()))
        return Acquisition(Registration.none(Source.PMD_DEPTH, f"at {seen_m:.1f} m"))

    def near(self, frame, _pose):
        return self.acquire(frame)


@pytest.mark.parametrize("range_m", [2.0, 4.0, 6.5, 7.0, 7.5, 8.0, 9.0, 10.0, 12.0])
def test_without_a_prediction_the_image_is_joined_and_the_multiple_is_tried(target, range_m):
    ideal = depth_frame(target, pose_at(range_m))
    inner = Listener(range_m)
    acquirer = PreparedAcquirer(inner, DepthPreparation(PmdInput(), target))
    assert acquirer.acquire(seen_by(ideal, MHZ_20)).outcome is Outcome.ACCEPTED
    assert inner.tried_m[-1] == pytest.approx(float(np.nanmedian(ideal.depth_m)), abs=1e-3)


def test_noise_has_no_distance_to_be_joined_around_and_all_are_tried(target):
    rng = np.random.default_rng(3)
    noise = frame_of(rng.uniform(0.1, 7.4, (CAMERA.height, CAMERA.width)))
    frame = noise.model_copy(update={"info": info(MHZ_20)})
    first, *others = DepthPreparation(PmdInput(), target).possible(frame)
    np.testing.assert_array_equal(first.depth_m, frame.depth_m)
    assert len(others) == 3
    assert max(np.nanmax(each.depth_m) for each in others) > 14.0


@pytest.mark.parametrize("wall_m", [9.8, 11.0, 14.0])
@pytest.mark.parametrize("range_m", [3.0, 7.5, 8.5])
def test_a_target_before_a_wall_is_whole_at_one_of_the_multiples(target, range_m, wall_m):
    ideal = depth_frame(target, pose_at(range_m))
    seen = np.isfinite(ideal.depth_m) & (ideal.depth_m > 0.0)
    room = ideal.model_copy(update={"depth_m": np.where(seen, ideal.depth_m, np.float32(wall_m))})
    tried = DepthPreparation(PmdInput(), target).possible(seen_by(room, MHZ_20))
    right = [np.abs(each.depth_m - ideal.depth_m)[seen].max() < 1e-3 for each in tried]
    assert any(right)


def test_what_fails_at_every_multiple_fails_for_the_reason_of_the_nearest(target):
    frame = seen_by(depth_frame(target, pose_at(3.0)), MHZ_20)
    failed = PreparedAcquirer(Listener(-9.0), DepthPreparation(PmdInput(), target)).acquire(frame)
    assert failed.outcome is Outcome.FAILED
    assert failed.belief.reason.startswith("at 2.")


def test_a_search_of_a_frame_that_states_a_gigahertz_is_bounded_and_says_so(target):
    inner = Listener(-9.0)
    noise = frame_of(np.random.default_rng(3).uniform(0.01, 0.14, (CAMERA.height, CAMERA.width)))
    frame = noise.model_copy(update={"info": info(1e9)})
    failed = PreparedAcquirer(inner, DepthPreparation(PmdInput(), target)).acquire(frame)
    assert len(inner.tried_m) <= 32
    assert "1000 MHz" in failed.belief.reason


def test_a_search_around_a_pose_is_given_the_multiple_by_it(target):
    inner = Listener(9.0)
    frame = seen_by(depth_frame(target, pose_at(9.0)), MHZ_20)
    PreparedAcquirer(inner, DepthPreparation(PmdInput(), target)).near(frame, pose_at(9.2))
    assert inner.tried_m[0] == pytest.approx(9.0, abs=0.6)


# --- what a frame leaves undetermined ---


class Sliding:
    """An acquirer and tracker whose pose is unknown in one direction, shape (6,), by 2 m or 115 deg."""

    def __init__(self, open_direction):
        covariance = 1e-6 * np.eye(6) + 4.0 * np.outer(open_direction, open_direction)
        self._found = Registration(Source.PMD_JOINT, pose_at(2.0), covariance=covariance)

    def acquire(self, _):
        return Acquisition(self._found)

    def near(self, *_):
        return Acquisition(self._found)

    def track(self, *_):
        return self._found


@pytest.mark.parametrize(("axis", "words"), [(0, "the position is"), (4, "the attitude is")])
def test_no_track_begins_at_a_pose_that_the_frame_leaves_undetermined(target, axis, words):
    ideal = depth_frame(target, pose_at(2.0))
    method, preparation = Sliding(np.eye(6)[axis]), DepthPreparation(PmdInput(), target)
    acquirer, tracker = PreparedAcquirer(method, preparation), PreparedTracker(method, preparation)
    for found in (
        acquirer.acquire(ideal),
        acquirer.near(ideal, pose_at(2.0)),
        tracker.track(ideal, pose_at(2.0)),
    ):
        assert not found.begins_track
        assert found.belief.refusal.startswith(words)


@pytest.mark.parametrize("part", [slice(0, 3), slice(3, 6)])
def test_errors_that_each_frame_of_a_camera_has_do_not_hinder_a_first_pose(target, part):
    """A target may be small for the errors of ranges that are not calibrated, as a bottle is."""
    shared = np.zeros(6)
    shared[part] = 0.17 * target.radius_m if part.start == 0 else np.radians(17.0)
    acquirer = PreparedAcquirer(Sliding(shared), DepthPreparation(PmdInput(), target))
    assert acquirer.acquire(depth_frame(target, pose_at(2.0))).begins_track


def test_the_angle_about_a_free_axis_may_stay_undetermined(target):
    ideal = depth_frame(target, pose_at(2.0))
    axis = np.array((0.0, 1.0, 0.0))
    revolved = replace(target, symmetries=(Symmetry(tuple(axis), order=12, exact=True, continuous=True),))
    method = Sliding(np.concatenate((np.zeros(3), OBLIQUE.apply(axis))))
    preparation = DepthPreparation(PmdInput(), revolved)
    assert PreparedAcquirer(method, preparation).acquire(ideal).begins_track
    assert PreparedTracker(method, preparation).track(ideal, pose_at(2.0)).begins_track


# --- frames of another camera ---


@pytest.mark.parametrize(
    ("configured", "told", "reason"),
    [
        (
            {"camera": CAMERA.model_copy(update={"fx": 500.0})},
            (),
            "camera_info: fx is 682.75, not 500 as in the configuration",
        ),
        (
            {"camera": CAMERA.model_copy(update={"width": 320})},
            (),
            "camera_info: width is 352, not 320 as in the configuration",
        ),
        ({"camera": CAMERA.model_copy(update={"cy": 120.0})}, (), "camera_info: cy is 143"),
        ({"camera": LENS}, (), "camera_info: distortion is 0, 0, 0, 0, 0"),
        (
            {"calibration": WIGGLING},
            (MHZ_30,),
            "modulation_frequency_hz: pmd/info says 30 MHz, the calibration says 20.013 MHz",
        ),
        (
            {"modulation_frequency_hz": (MHZ_20,)},
            (MHZ_20, MHZ_30),
            "modulation_frequency_hz: pmd/info says 20.013 and 30 MHz, the configuration says 20.013 MHz",
        ),
    ],
)
def test_a_frame_of_another_camera_is_refused_by_the_field(target, configured, told, reason):
    methods = methods_of(PmdInput(**configured), target)
    frame = frame_of(4.0).model_copy(update={"info": info(*told) if told else None})
    tracked = methods.tracker.track(frame, pose_at(4.0))
    assert tracked.T_sensor_target is None
    assert tracked.belief.reason.startswith(reason)
    for found in (methods.acquirer.acquire(frame), methods.acquirer.near(frame, pose_at(4.0))):
        assert found.outcome is Outcome.FAILED
        assert found.belief.reason == tracked.belief.reason


def test_a_frame_of_the_configured_camera_is_taken(target):
    sensor = PmdInput(camera=CAMERA, modulation_frequency_hz=(MHZ_20,), calibration=WIGGLING)
    frame = depth_frame(target, pose_at(4.0)).model_copy(update={"info": info(MHZ_20 * (1.0 + 1e-6))})
    assert DepthPreparation(sensor, target).refusal(frame) == ""


@pytest.mark.parametrize("name", strange_frames())
def test_strange_frames_pass_to_the_methods_without_an_error(target, name):
    frame = strange_frames()[name].model_copy(update={"info": info(MHZ_20)})
    sensor = PmdInput(calibration=WIGGLING)
    registration = methods_of(sensor, target).tracker.track(frame, pose_at(4.0))
    assert registration.belief.reason
    for prepared in DepthPreparation(sensor, target).possible(frame):
        assert prepared.depth_m.shape == frame.depth_m.shape


def test_what_is_farther_than_the_camera_can_tell_has_not_been_wrapped(target):
    frame = frame_of(9.0).model_copy(update={"info": info(MHZ_20)})
    prepared = DepthPreparation(PmdInput(), target).predicted(frame, pose_at(1.6))
    np.testing.assert_allclose(prepared.depth_m, 9.0, rtol=1e-6)
    near = frame_of(7.0).model_copy(update={"info": info(MHZ_20)})
    prepared = DepthPreparation(PmdInput(), target).predicted(near, pose_at(0.5))
    np.testing.assert_allclose(prepared.depth_m, 7.0, rtol=1e-6, err_msg="not to behind the camera")


_KERNEL = """
import subprocess
import sys

import numpy as np
from rpod_pose.pmd.depth_preparation import _prepare
depth = np.full((4, 5), 3.0, np.float32)
for interval in (float("inf"), float("nan"), 1e300, 1e-300, 0.0):
    for reach in (0.0, 0.5, float("nan")):
        out = np.zeros_like(depth)
        _prepare(depth, np.ones_like(depth), (4.0, reach, interval), np.zeros(30_000, np.float32), out)
"""


def test_the_kernel_reads_no_correction_outside_its_table_whatever_the_unambiguous_range():
    finished = subprocess.run([sys.executable, "-c", _KERNEL], capture_output=True, text=True, check=False)
    assert finished.returncode == 0, finished.stderr
