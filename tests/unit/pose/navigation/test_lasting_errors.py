"""Errors that last: what a measured pose shares with others, and offsets between two sensors' mounts."""

from dataclasses import replace
from math import radians

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_pose.navigation.filter import POSE, TWIST, FilterState, predict
from rpod_pose.navigation.integrity.clocks import clock_of_mounts
from rpod_pose.navigation.integrity.mounts import mount_offsets
from rpod_pose.navigation.pose_measurement import Origin, PoseMeasurement, shared_errors, started, updated
from rpod_pose.pose_evidence import ErrorParts
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.estimator.filter import FilterConfig
from rpod_schemas.config.estimator.integrity import IntegrityConfig
from rpod_schemas.poses import make_pose

SECOND_NS = 1_000_000_000
CONSIDERED = FilterConfig(errors="considered")
MOUNTS = FilterConfig(errors="considered", mount_sigma_deg=0.3, mount_sigma_m=0.02)
FRONT = make_pose(rotation=Rotation.from_rotvec([0.1, 0.2, -0.1]), translation_m=[0.3, 0.0, 0.5])
BESIDE = make_pose(translation_m=[-0.3, 0.1, 0.4])


def diagonal(m: float, rad: float) -> FloatArray:
    return np.diag(np.repeat([m, rad], 3) ** 2)


PARTS = ErrorParts(
    white=diagonal(1e-3, 1e-3),
    of_sensor=np.diag([0.0, 0.0, 9e-6, 0.0, 0.0, 0.0]),
    of_image=diagonal(2e-3, 2e-3),
    image_turn_rad=radians(0.5),
    of_model=diagonal(3e-3, 4e-3),
)


def measured(
    pose: RigidTransform, mount: RigidTransform, *, sensor: str = "pmd", stamp_ns: int = 0
) -> PoseMeasurement:
    return PoseMeasurement(stamp_ns, pose, diagonal(5e-3, 5e-3), Origin(sensor, mount, PARTS))


def target(stamp_s: float) -> RigidTransform:
    turn = Rotation.from_euler("x", 3.0 * stamp_s, degrees=True)
    return make_pose(rotation=turn, translation_m=[0.1, 0.0, 6.0 - 0.1 * stamp_s])


def test_the_parts_of_a_pose_together_are_the_covariance_of_a_first_state():
    state = started(measured(target(0.0), FRONT), config=CONSIDERED)
    R = np.kron(np.eye(2), FRONT.rotation.as_matrix())
    whole = PARTS.white + PARTS.of_sensor + PARTS.of_image + PARTS.of_model
    np.testing.assert_allclose(state.covariance[POSE, POSE], R @ whole @ R.T, atol=1e-12)
    assert [block.considered for block in state.blocks] == [True, True, True]


def test_a_scan_that_takes_time_is_as_uncertain_as_the_twist_that_de_skewed_it():
    scan = replace(measured(target(0.0), FRONT), lasting_s=0.05)
    first = started(scan, config=CONSIDERED)
    at_once = started(replace(scan, lasting_s=0.0), config=CONSIDERED)
    more = first.covariance[POSE, POSE] - at_once.covariance[POSE, POSE]
    twist = at_once.covariance[TWIST, TWIST]
    np.testing.assert_allclose(more, 0.05**2 * twist, atol=1e-9)
    known = replace(first, covariance=np.diag(np.full(len(first.covariance), 1e-8)))
    pose = first.T_chaser_target
    slow, quick = (
        updated(known, replace(scan, T_chaser_target=pose, lasting_s=s), CONSIDERED) for s in (0.05, 0.0)
    )
    np.testing.assert_allclose(slow.state.covariance, quick.state.covariance, atol=1e-10)


def test_many_frames_leave_the_errors_of_calibration_and_model_and_average_the_noise_out():
    config = CONSIDERED.model_copy(
        update={"acceleration_density_m2_s3": 1e-10, "angular_acceleration_density_rad2_s3": 1e-10}
    )
    at = target(0.0)
    state = started(measured(at, FRONT), config=config)
    for frame in range(1, 150):
        stamp_ns = frame * SECOND_NS // 15
        state = updated(
            predict(state, stamp_ns, config), measured(at, FRONT, stamp_ns=stamp_ns), config
        ).state
    lasting = PARTS.of_sensor + PARTS.of_model + PARTS.of_image  # a resting image does not move
    R = np.kron(np.eye(2), FRONT.rotation.as_matrix())
    left = state.covariance[POSE, POSE] - R @ lasting @ R.T
    assert 0.0 < np.linalg.eigvalsh(left).max() < 0.2e-6


def test_frames_that_state_one_error_differently_do_not_tell_what_it_is():
    rng, at, off_rad = np.random.default_rng(7), target(0.0), 4e-3
    turned = Rotation.from_rotvec([off_rad, 0.0, 0.0]) * at.rotation
    pose = make_pose(rotation=turned, translation_m=at.translation)
    state = None
    for frame in range(60):
        of_model = diagonal(1e-4, 4e-3) * rng.uniform(0.5, 1.5)
        parts = ErrorParts.lasting_model(diagonal(2e-4, 2e-4), of_model)
        stamp_ns = frame * SECOND_NS // 45
        each = PoseMeasurement(stamp_ns, pose, of_model, Origin("pmd", FRONT, parts))
        if state is None:
            state = started(each, config=CONSIDERED)
        else:
            state = updated(predict(state, stamp_ns, CONSIDERED), each, CONSIDERED).state
    assert state is not None
    error = (state.T_chaser_target.rotation * at.rotation.inv()).as_rotvec()
    assert np.linalg.norm(error) == pytest.approx(off_rad, rel=0.1)
    assert np.sqrt(state.covariance[3, 3]) == pytest.approx(4e-3, rel=0.15)


def test_a_pose_that_the_gate_rejects_says_nothing_of_the_errors_that_frames_share():
    state = started(measured(target(0.0), FRONT), config=CONSIDERED)
    large = replace(PARTS, of_model=diagonal(0.3, 1e-3), of_image=diagonal(0.2, 1e-3))
    far = make_pose(translation_m=[0.1, 15.0, 6.0])
    wrong = PoseMeasurement(SECOND_NS, far, diagonal(5e-3, 5e-3), Origin("pmd", FRONT, large))
    predicted = predict(state, SECOND_NS, CONSIDERED)
    found = updated(predicted, wrong, CONSIDERED)
    assert not found.accepted
    assert found.state is predicted
    other = replace(wrong, origin=Origin("lidar", BESIDE, PARTS))
    assert updated(predicted, other, CONSIDERED).state.size == predicted.size


def test_with_inflation_nothing_is_shared_and_without_an_origin_neither():
    assert shared_errors(measured(target(0.0), FRONT), FilterConfig()).blocks == ()
    alone = replace(measured(target(0.0), FRONT), origin=None)
    assert shared_errors(alone, MOUNTS).blocks == ()


def as_stated(pose: RigidTransform, error: FloatArray, mount: RigidTransform) -> RigidTransform:
    """Return where a target at a pose appears if the stated mount is the true one moved by an error."""
    turn, place = Rotation.from_rotvec(error[3:]), mount.translation
    stated = make_pose(rotation=turn * mount.rotation, translation_m=place + error[:3])
    return stated * mount.inv() * pose


def followed(bias_m: float, true_m: float = 0.0) -> tuple[FilterState, FloatArray]:
    """Return a state after 30 s of a LIDAR and a camera, and the error of the camera's stated mount.

    The camera's distances may have a bias of a standard deviation, and have a true one.
    """
    rng = np.random.default_rng(4)
    error = np.concatenate([[0.012, -0.016, 0.0], np.radians([0.18, 0.0, 0.24])])

    def noisy(pose: RigidTransform) -> RigidTransform:
        off = 1e-3 * rng.normal(size=6)
        turn = Rotation.from_rotvec(off[3:]) * pose.rotation
        return make_pose(rotation=turn, translation_m=pose.translation + off[:3])

    no_parts = ErrorParts.lasting_model(diagonal(1e-3, 1e-3), np.zeros((6, 6)))
    along = np.diag([0.0, 0.0, bias_m**2, 0.0, 0.0, 0.0])
    seen = (
        ("lidar", BESIDE, np.zeros(6), no_parts),
        ("pmd", FRONT, error, replace(no_parts, of_sensor=along)),
    )
    state = None
    for stamp_s in np.arange(0.0, 30.0, 0.5):
        stamp_ns, truth = round(stamp_s * SECOND_NS), target(stamp_s)
        for sensor, mount, off, parts in seen:
            pose = noisy(as_stated(truth, off, mount))
            if sensor == "pmd":
                longer_m = true_m * as_stated(mount, off, mount).rotation.as_matrix()[:, 2]
                pose = make_pose(rotation=pose.rotation, translation_m=pose.translation + longer_m)
            # the stated mount is what the pose was computed with
            stated = as_stated(mount, off, mount)
            each = PoseMeasurement(stamp_ns, pose, diagonal(1e-3, 1e-3), Origin(sensor, stated, parts))
            if state is None:
                state = started(each, config=MOUNTS)
            else:
                state = updated(predict(state, stamp_ns, MOUNTS), each, MOUNTS).state
    assert state is not None
    return state, error


@pytest.fixture(scope="module")
def tracked() -> tuple[FilterState, FloatArray]:
    return followed(0.0)


def test_a_mount_along_the_boresight_is_not_told_from_a_bias_of_depth():
    """A camera that is not calibrated beside a LIDAR."""
    bias_m = 0.04
    state, _ = followed(bias_m)
    (offset,) = mount_offsets(state, ["lidar", "pmd"])
    places = state.places()
    boresight = FRONT.rotation.as_matrix()[:, 2]
    mount, other = (np.zeros(state.size), np.zeros(state.size))
    mount[places["mount of pmd"]][:3] = boresight
    mount[places["mount of lidar"]][:3] = -boresight
    other[places["calibration of pmd"]][2] = bias_m
    sigma = [np.sqrt(each @ state.covariance @ each) for each in (mount, other)]
    prior_m = 0.02 * np.sqrt(2.0)
    assert sigma[0] == pytest.approx(prior_m * bias_m / np.hypot(prior_m, bias_m), rel=0.05)
    assert sigma[1] == pytest.approx(bias_m)
    # of both together, the mount gets the share that its prior has
    share = prior_m**2 / (prior_m**2 + bias_m**2)
    assert mount @ state.covariance @ other == pytest.approx(-share * bias_m**2, rel=0.05)
    across = FRONT.rotation.as_matrix()[:, 0]
    assert np.sqrt(across @ offset.covariance[:3, :3] @ across) < 3e-3
    assert "with the bias of the distances of pmd, of which it cannot be told" in offset.describe()


@pytest.mark.parametrize("true_m", [0.03, -0.05])
def test_mount_and_bias_of_depth_along_the_boresight_are_reported_as_one(true_m: float):
    state, error = followed(0.04, true_m)
    (offset,) = mount_offsets(state, ["lidar", "pmd"], MOUNTS.mount_sigma_m)
    boresight = FRONT.rotation.as_matrix()[:, 2]
    assert offset.longer is not None
    off_m = offset.longer.length_m - (true_m + boresight @ error[:3])
    assert abs(off_m) < 3.0 * offset.longer.sigma_m
    assert offset.longer.sigma_m < 2e-3
    assert abs(boresight @ offset.error[:3] - offset.longer.length_m) > 0.3 * abs(true_m)
    assert (
        f"together they make those of pmd {1e3 * offset.longer.length_m:.0f} mm longer" in offset.describe()
    )
    evidence = offset.evidence
    assert evidence["distances_of_pmd_longer_than_of_lidar_m"] == offset.longer.length_m
    assert evidence["distances_of_pmd_longer_than_of_lidar_sigma_m"] == offset.longer.sigma_m


def test_the_offset_between_two_mounts_is_found_with_its_sigma(tracked: tuple[FilterState, FloatArray]):
    state, error = tracked
    (offset,) = mount_offsets(state, ["pmd", "lidar", "other"])
    assert (offset.one, offset.other) == ("lidar", "pmd")
    off = offset.error - error
    assert np.degrees(np.linalg.norm(off[3:])) < 0.05
    assert np.linalg.norm(off[:3]) < 3e-3
    sigmas = np.sqrt(np.diag(offset.covariance))
    assert (np.abs(off) < 3.5 * sigmas).all()
    assert sigmas[:3].max() < 3e-3
    assert offset.evidence["mount_of_pmd_from_lidar_about_z_deg"] == pytest.approx(0.24, abs=0.05)
    assert offset.evidence["mount_of_pmd_from_lidar_sigma_x_m"] == pytest.approx(sigmas[0])


def test_what_both_mounts_have_in_common_stays_in_the_covariance(tracked: tuple[FilterState, FloatArray]):
    state, _ = tracked
    sigma = np.sqrt(np.linalg.eigvalsh(state.covariance[3:6, 3:6]))
    assert sigma.min() > 0.99 * radians(0.3) / np.sqrt(2.0)


@pytest.mark.parametrize(("declared_deg", "declared_m", "fails"), [(0.02, 0.001, True), (0.3, 0.02, False)])
def test_an_offset_is_too_large_only_where_the_mounts_are_declared_better(
    tracked: tuple[FilterState, FloatArray], declared_deg: float, declared_m: float, fails: bool
):
    (offset,) = mount_offsets(tracked[0], ["lidar", "pmd"])
    config = IntegrityConfig(mount_sigma_deg=declared_deg, mount_sigma_m=declared_m)
    assert (offset.excess(config) > 38.3) is fails  # chi squared of 6 degrees of freedom at 1e-6
    assert offset.describe().startswith("the mounts of lidar and pmd disagree by 0.3")


def test_an_offset_between_mounts_that_late_stamps_explain_says_so(tracked: tuple[FilterState, FloatArray]):
    """A mount that is turned about the axis of the rate looks like late stamps: the text names both."""
    state, _ = tracked
    (offset,) = mount_offsets(state, ["lidar", "pmd"])
    assert clock_of_mounts(offset, state) == ""
    late_s = 0.05
    moved = -late_s * np.concatenate([state.velocity_m_s, state.rate_rad_s])
    moved[:3] -= np.cross(moved[3:], state.T_chaser_target.translation)
    text = clock_of_mounts(replace(offset, error=moved), state)
    assert text.startswith(", or the stamps of pmd are 50 +- ")
    assert text.endswith("ms late against those of lidar")


def test_one_sensor_tells_no_offset_and_keeps_the_whole_uncertainty_of_its_mount():
    state = started(measured(target(0.0), FRONT), config=MOUNTS)
    assert mount_offsets(state, ["pmd", "lidar"]) == []
    assert np.linalg.eigvalsh(state.covariance[3:6, 3:6]).min() > radians(0.3) ** 2
