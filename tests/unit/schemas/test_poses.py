import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation, Slerp

from rpod_schemas.poses import between, chained, covariance_at, make_pose, rotation_of


def some_pose(seed: int) -> RigidTransform:
    rng = np.random.default_rng(seed)
    return make_pose(rotation=Rotation.random(rng=rng), translation_m=rng.normal(size=3))


def test_a_pose_is_made_and_taken_apart_as_by_scipy() -> None:
    rotation, translation_m = Rotation.from_rotvec([0.1, -2.0, 0.7]), [1.0, -2.0, 3.0]
    pose = make_pose(rotation=rotation, translation_m=translation_m)
    by_scipy = RigidTransform.from_components(translation_m, rotation)
    np.testing.assert_allclose(pose.as_matrix(), by_scipy.as_matrix(), atol=1e-15)
    np.testing.assert_allclose(rotation_of(pose).as_matrix(), by_scipy.rotation.as_matrix(), atol=1e-15)


def test_poses_are_chained_as_by_scipy() -> None:
    first, second = some_pose(1), some_pose(2)
    np.testing.assert_allclose(
        chained(first, second).as_matrix(), (first * second).as_matrix(), rtol=0.0, atol=1e-14
    )


def test_between_two_poses_attitude_goes_as_in_scipys_slerp_and_position_straight() -> None:
    first, second = some_pose(3), some_pose(4)
    slerp = Slerp([0.0, 1.0], Rotation.concatenate([first.rotation, second.rotation]))
    for share in (0.0, 0.3, 1.0):
        pose = between(first, second, share)
        np.testing.assert_allclose(rotation_of(pose).as_matrix(), slerp(share).as_matrix(), atol=1e-14)
        np.testing.assert_allclose(
            pose.translation, (1.0 - share) * first.translation + share * second.translation, atol=1e-15
        )


def test_the_covariance_at_a_place_of_the_body_is_that_of_many_drawn_poses_there() -> None:
    rng = np.random.default_rng(5)
    root = rng.normal(size=(6, 6)) * 1e-3
    body, place_m = some_pose(6), np.array([0.5, -2.0, 1.0])
    errors = rng.normal(size=(200_000, 6)) @ root.T
    R = Rotation.from_rotvec(errors[:, 3:]) * body.rotation
    drawn = np.hstack([body.translation + errors[:, :3] + R.apply(place_m), errors[:, 3:]])
    found = covariance_at(root @ root.T, body.rotation.apply(place_m))
    np.testing.assert_allclose(found, np.cov(drawn.T), atol=0.02 * found.max())
