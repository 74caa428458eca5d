"""The ray caster against analytic bodies and against Open3D."""

import cv2
import numpy as np
import open3d as o3d
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_geometry.errors import DistortionError
from rpod_geometry.lens import distort, undistort
from rpod_geometry.lines import slopes_ahead
from rpod_geometry.rays import Hits, RayGrid, cast, cast_pose
from rpod_schemas.arrays import FloatArray
from rpod_schemas.errors import MessageRejectedError
from rpod_schemas.messages.lenses import coefficients
from rpod_schemas.poses import make_pose
from rpod_schemas.types import Camera

CAMERA = Camera(width=88, height=72, fx=170.7, fy=172.9, cx=43.7, cy=35.6)
BARREL = CAMERA.model_copy(update={"distortion": np.array([-0.35, 0.12, 0.002, -0.003, -0.01])})
GRIDS = {
    "pinhole": RayGrid.pinhole(CAMERA, 2),
    "distorted pinhole": RayGrid.pinhole(BARREL, 2),
    "narrow LIDAR": RayGrid.azimuth_elevation(np.linspace(-0.35, 0.35, 41), np.linspace(-0.3, 0.3, 31)),
    "wide LIDAR": RayGrid.azimuth_elevation(np.linspace(-1.5, 1.5, 61), np.linspace(-1.4, 1.4, 31)),
    "LIDAR that looks around": RayGrid.azimuth_elevation(
        np.linspace(-3.1, 3.1, 61), np.linspace(-1.5, 1.5, 31)
    ),
}
SQUARE = np.array([[[-1, -1, 0], [-1, 1, 0], [1, 1, 0]], [[-1, -1, 0], [1, 1, 0], [1, -1, 0]]], dtype=float)
"""A plate of 2 x 2 m whose outward normal is -z: it faces a sensor that looks along z."""
AHEAD = make_pose(translation_m=(0.0, 0.0, 3.0))


def box(half_m: float) -> FloatArray:
    mesh = o3d.geometry.TriangleMesh.create_box(2 * half_m, 2 * half_m, 2 * half_m).translate((-half_m,) * 3)
    return np.asarray(mesh.vertices)[np.asarray(mesh.triangles)]


def sphere(radius_m: float) -> FloatArray:
    mesh = o3d.geometry.TriangleMesh.create_sphere(radius_m, resolution=60)
    return np.asarray(mesh.vertices)[np.asarray(mesh.triangles)]


def open3d_range(grid: RayGrid, triangles_m: FloatArray, pose: RigidTransform) -> FloatArray:
    scene = o3d.t.geometry.RaycastingScene()
    corners = pose.apply(triangles_m.reshape(-1, 3)).astype(np.float32)
    scene.add_triangles(corners, np.arange(len(corners), dtype=np.uint32).reshape(-1, 3))
    rays = np.concatenate((np.zeros_like(grid.directions), grid.directions), axis=-1, dtype=np.float32)
    found: FloatArray = scene.cast_rays(o3d.core.Tensor(rays))["t_hit"].numpy()
    return found


@pytest.mark.parametrize("grid", GRIDS.values(), ids=GRIDS)
@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), near=st.booleans())
def test_every_ray_meets_what_open3d_finds(grid: RayGrid, seed: int, near: bool) -> None:
    random = np.random.default_rng(seed)
    spread = (1.0, 1.0, 2.0) if near else (0.5, 0.5, 1.0)  # near: around the sensor and behind it
    triangles = random.normal(scale=spread, size=(40, 1, 3)) + random.normal(scale=0.4, size=(40, 3, 3))
    pose = make_pose(rotation=Rotation.random(rng=random), translation_m=(0, 0, 0 if near else 5))
    ours = cast(grid, triangles, pose).range_m
    theirs = open3d_range(grid, triangles, pose)
    differing = ~np.isclose(ours, theirs, rtol=1e-4, atol=1e-5)
    assert differing.mean() < 2e-3  # single precision at silhouettes


@pytest.mark.parametrize("grid", GRIDS.values(), ids=GRIDS)
def test_a_plate_is_met_at_its_analytic_range(grid: RayGrid) -> None:
    tilted = make_pose(
        rotation=Rotation.from_euler("xy", (25, -40), degrees=True), translation_m=(0.1, -0.2, 3)
    )
    normal = tilted.rotation.apply((0.0, 0.0, 1.0))
    with np.errstate(divide="ignore"):
        expected = normal @ tilted.translation / (grid.directions @ normal)
    hits = cast(grid, 20.0 * SQUARE, tilted)
    met = np.isfinite(hits.range_m)
    points = tilted.inv().apply(
        (grid.directions * np.where(met, hits.range_m, 0.0)[..., None]).reshape(-1, 3)
    )
    inside = (expected > 0) & (expected < 20)
    assert inside.any()
    assert met[inside].all()
    np.testing.assert_allclose(hits.range_m[inside], expected[inside], rtol=1e-6)
    assert np.abs(points[met.ravel()]).max() < 20.001


def test_a_sphere_is_met_at_its_analytic_range() -> None:
    grid = GRIDS["pinhole"]
    centre = np.array([0.2, 0.1, 4.0])
    along = grid.directions @ centre
    inside = along**2 - centre @ centre + 0.45**2  # well off the limb of a sphere of 0.5 m
    expected = along - np.sqrt(np.maximum(along**2 - centre @ centre + 0.25, 0.0))
    hits = cast(grid, sphere(0.5), make_pose(translation_m=centre))
    met = inside > 0
    np.testing.assert_allclose(hits.range_m[met], expected[met], atol=2e-3)  # facets of a 60 x 120 mesh
    assert np.isinf(hits.range_m[along**2 - centre @ centre + 0.25 < 0]).all()
    assert (hits.triangle[np.isinf(hits.range_m)] == -1).all()


def test_no_ray_slips_through_the_shared_edges_of_a_closed_box() -> None:
    inside = cast(GRIDS["LIDAR that looks around"], box(1.0), RigidTransform.identity())
    assert np.isfinite(inside.range_m).all()
    symmetric = Camera(
        width=64, height=64, fx=64, fy=64, cx=31.5, cy=31.5
    )  # its diagonal lies on the plate's
    assert np.isfinite(cast(RayGrid.pinhole(symmetric), 2.0 * SQUARE, AHEAD).range_m).all()


def test_back_faces_are_met_unless_culled() -> None:
    grid = GRIDS["pinhole"]
    behind = make_pose(rotation=Rotation.from_euler("y", 180, degrees=True), translation_m=(0, 0, 3))
    for pose, culled_away in ((AHEAD, False), (behind, True)):
        assert np.isfinite(cast(grid, SQUARE, pose).range_m).all()
        assert np.isinf(cast(grid, SQUARE, pose, cull_back_faces=True).range_m).all() == culled_away


def test_culling_changes_nothing_on_a_closed_body_seen_from_outside() -> None:
    pose = make_pose(
        rotation=Rotation.from_euler("xyz", (20, 50, -30), degrees=True), translation_m=(0, 0, 3)
    )
    free, culled = (cast(GRIDS["pinhole"], box(0.4), pose, cull_back_faces=cull) for cull in (False, True))
    np.testing.assert_array_equal(free.range_m, culled.range_m)
    np.testing.assert_array_equal(free.triangle, culled.triangle)


def test_what_lies_behind_a_camera_is_not_met() -> None:
    hits = cast(GRIDS["pinhole"], box(0.4), make_pose(translation_m=(0, 0, -2)))
    assert np.isinf(hits.range_m).all()


def test_a_plate_through_the_near_plane_is_met_where_it_is_ahead() -> None:
    floor = make_pose(rotation=Rotation.from_euler("x", 90, degrees=True), translation_m=(0, 0.3, 0))
    hits = cast(GRIDS["pinhole"], 10.0 * SQUARE, floor)
    down = GRIDS["pinhole"].directions[..., 1]
    np.testing.assert_allclose(hits.range_m[down > 0.05], 0.3 / down[down > 0.05], rtol=1e-6)
    assert np.isinf(hits.range_m[down <= 0.0]).all()


def test_the_nearest_of_several_triangles_wins_in_any_order() -> None:
    layers = np.concatenate([SQUARE + np.array((0, 0, z)) for z in (0.5, -0.5, 0.0)])
    hits = cast(GRIDS["pinhole"], layers, AHEAD)
    assert set(np.unique(hits.triangle)) == {2, 3}
    np.testing.assert_allclose(hits.range_m * GRIDS["pinhole"].directions[..., 2], 2.5, rtol=1e-6)


def test_buffers_are_reused_and_cleared() -> None:
    grid = GRIDS["pinhole"]
    buffers = Hits.of(grid)
    assert cast(grid, SQUARE, AHEAD, out=buffers) is buffers
    assert np.isfinite(buffers.range_m).all()
    cast(grid, SQUARE, make_pose(translation_m=(0, 0, -3)), out=buffers)
    assert np.isinf(buffers.range_m).all()
    assert (buffers.triangle == -1).all()


def test_a_degenerate_triangle_is_never_met() -> None:
    line = np.array([[[-1.0, 0, 0], [0, 0, 0], [1.0, 0, 0]]])
    assert np.isinf(cast(GRIDS["pinhole"], line, AHEAD).range_m).all()


@pytest.mark.parametrize("camera", [CAMERA, BARREL], ids=["pinhole", "distorted"])
def test_rays_project_back_onto_their_pixels_in_opencv(camera: Camera) -> None:
    rays = RayGrid.pinhole(camera).directions
    pixels, _ = cv2.projectPoints(
        rays.reshape(-1, 1, 3), np.zeros(3), np.zeros(3), camera.K, camera.distortion
    )
    columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    np.testing.assert_allclose(pixels.reshape(rays.shape[0], -1, 2), np.stack((columns, rows), -1), atol=1e-7)


def test_samples_lie_evenly_about_the_centre_of_their_pixel() -> None:
    fine = RayGrid.pinhole(CAMERA, 2).directions
    slopes = (fine[..., :2] / fine[..., 2:]).reshape(CAMERA.height, 2, CAMERA.width, 2, 2)
    coarse = RayGrid.pinhole(CAMERA).directions
    np.testing.assert_allclose(slopes.mean(axis=(1, 3)), coarse[..., :2] / coarse[..., 2:], atol=1e-12)


@given(st.tuples(*[st.floats(-0.3, 0.3)] * 2), st.floats(-0.4, 0.4), st.floats(-0.01, 0.01))
def test_undistort_inverts_distort(slope: tuple[float, float], k1: float, p1: float) -> None:
    camera = CAMERA.model_copy(update={"distortion": np.array([k1, 0.1, p1, -p1, 0.0])})
    there = distort(np.array(slope)[:, None], camera)
    np.testing.assert_allclose(undistort(there, camera)[:, 0], slope, atol=1e-9)


KINECT = np.array([5.26, 3.55, 4e-5, -9e-5, 0.18, 5.59, 5.41, 0.95])
"""As the depth camera of an Azure Kinect has them: no numerator or denominator near 1."""


def test_a_rational_lens_is_that_of_opencv_and_has_an_inverse() -> None:
    slopes = np.random.default_rng(5).uniform(-1.4, 1.4, (2, 200))
    camera = CAMERA.model_copy(update={"distortion": KINECT})
    there = distort(slopes, camera)
    points = np.vstack((slopes, np.ones(200))).T
    expected, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), np.eye(3), KINECT)
    np.testing.assert_allclose(there.T, expected[:, 0], atol=1e-9)
    np.testing.assert_allclose(undistort(there, camera), slopes, atol=1e-6)


@pytest.mark.parametrize(("most_deg", "most_px"), [(55.0, 0.002), (70.0, 0.1)])
def test_a_fisheye_lens_is_that_of_opencv(most_deg: float, most_px: float) -> None:
    k = (0.05, -0.02, 0.01, -0.003)
    rng = np.random.default_rng(6)
    theta, turn = np.radians(most_deg) * rng.uniform(0.01, 1.0, 200), rng.uniform(0.0, 2.0 * np.pi, 200)
    slopes = np.tan(theta) * np.stack((np.cos(turn), np.sin(turn)))
    points = np.vstack((slopes, np.ones(200))).T[:, None]
    expected, _ = cv2.fisheye.projectPoints(points, np.zeros(3), np.zeros(3), np.eye(3), np.array(k))
    fitted = coefficients("equidistant", k, float(np.linalg.norm(expected, axis=-1).max()))
    camera = CAMERA.model_copy(update={"distortion": fitted})
    there = distort(slopes, camera)
    assert np.abs(there.T - expected[:, 0]).max() * 300.0 < most_px
    np.testing.assert_allclose(undistort(there, camera), slopes, atol=1e-5)


def test_a_fisheye_lens_that_sees_too_far_is_refused() -> None:
    with pytest.raises(MessageRejectedError, match="80 deg"):
        coefficients("fisheye", (0.0, 0.0, 0.0, 0.0), 1.5)


def test_a_distortion_that_folds_the_image_is_refused_by_pixel() -> None:
    folding = CAMERA.model_copy(update={"distortion": np.array([-8.0, 0, 0, 0, 0])})
    with pytest.raises(DistortionError, match=r"no inverse at pixel \(0\.0, 0\.0\)"):
        RayGrid.pinhole(folding)


def test_azimuth_and_elevation_follow_the_interface() -> None:
    grid = RayGrid.azimuth_elevation(np.array([-0.2, 0.0, 0.3]), np.array([0.0, 0.1]))
    assert grid.shape == (2, 3)
    expected = (np.sin(0.3) * np.cos(0.1), np.sin(0.1), np.cos(0.3) * np.cos(0.1))
    np.testing.assert_allclose(grid.directions[1, 2], expected)
    np.testing.assert_allclose(np.linalg.norm(grid.directions, axis=-1), 1.0)


@pytest.mark.parametrize("cull", [False, True])
def test_the_kernel_that_takes_a_pose_meets_what_cast_meets(cull: bool) -> None:
    random = np.random.default_rng(3)
    for grid in GRIDS.values():
        pose = make_pose(rotation=Rotation.random(rng=random), translation_m=(0.3, -0.2, 4.0))
        expected = cast(grid, box(0.7), pose, cull_back_faces=cull)
        range_m, triangle = np.full(grid.shape, np.nan, np.float32), np.full(grid.shape, 99, np.int32)
        R, t = pose.rotation.as_matrix(), pose.translation
        cast_pose(grid.arrays, box(0.7), R, t, cull, range_m, triangle)
        np.testing.assert_array_equal(range_m, expected.range_m)
        np.testing.assert_array_equal(triangle, expected.triangle)


@pytest.mark.parametrize("grid", GRIDS.values(), ids=GRIDS)
def test_a_block_of_a_grid_meets_what_its_rays_meet_in_the_whole(grid: RayGrid) -> None:
    pose = make_pose(rotation=Rotation.from_rotvec((0.4, 0.8, -0.3)), translation_m=(0.1, 0.0, 2.0))
    whole = cast(grid, box(0.5), pose)
    R, t = pose.rotation.as_matrix(), pose.translation
    met = 0
    for rows, columns in [
        (slice(0, None), slice(0, None)),
        (slice(5, 25), slice(10, 40)),
        (slice(15, 16), slice(3, 60)),
        (slice(-10, None), slice(0, 35)),
    ]:
        expected = whole.triangle[rows, columns]
        range_m, triangle = np.empty(expected.shape, np.float32), np.empty(expected.shape, np.int32)
        cast_pose(grid.block(rows, columns), box(0.5), R, t, False, range_m, triangle)
        np.testing.assert_array_equal(triangle, expected)
        np.testing.assert_array_equal(range_m, whole.range_m[rows, columns])
        met += np.count_nonzero(triangle >= 0)
    assert met > 0


@given(ends=st.tuples(*[st.floats(-5.0, 5.0)] * 4))
def test_the_slopes_of_a_line_are_those_of_its_part_ahead(ends: tuple[float, float, float, float]) -> None:
    a, a_z, b, b_z = ends
    low, high = slopes_ahead(a, a_z, b, b_z)
    along = np.linspace(0.0, 1.0, 1001)
    x, z = a + along * (b - a), a_z + along * (b_z - a_z)
    slopes = x[z > 1e-9] / z[z > 1e-9]
    assert (
        (low - 1e-6 * (1.0 + abs(slopes)) <= slopes) & (slopes <= high + 1e-6 * (1.0 + abs(slopes)))
    ).all()
    if a_z > 0.1 and b_z < -0.1 and abs(a * b_z - b * a_z) > 1.0:  # its slopes are unbounded on one side only
        assert np.isinf(low) != np.isinf(high)
    if max(a_z, b_z) <= 0.0:
        assert low > high
