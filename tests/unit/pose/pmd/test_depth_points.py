"""Depth points: distances from the planes of the faces that the pixels show, and from the field elsewhere."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rpod_geometry.rays import RayGrid, cast
from rpod_pose.pmd.depth_view import DepthView, noise_of_medians
from rpod_pose.pmd.joint.depth_points import DepthImages, Planes, add_depth_points, coarse_ranges
from rpod_pose.pmd.joint.edge_search import CoarsePixels
from rpod_pose.pmd.joint.tracker import JointTracker
from rpod_pose.registration.distance_field import FieldArrays, field_arrays
from rpod_pose.registration.field_alignment import Points
from rpod_pose.registration.gauss_newton import State
from rpod_pose.registration.lie_group import PoseArrays
from rpod_pose.registration.normal_equations import gradient_of, information_of, no_sums
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.motion import FACING
from rpod_schemas.config.pmd import PmdConfig
from rpod_schemas.config.pmd.joint import JointConfig
from rpod_schemas.poses import make_pose
from rpod_schemas.types import Camera, PmdFrame
from rpod_sim_sensor.pmd import PmdEmulator
from rpod_target import DistanceField, Target, load_target

CELLS = 8
MOCKUP = load_target("mockup")
TRUTH = make_pose(
    rotation=FACING * Rotation.from_euler("ZYX", (8.0, -12.0, 25.0), degrees=True),
    translation_m=(0.1, -0.05, 2.2),
)


def with_coarse_field(target: Target) -> Target:
    """Return a target whose field has every eighth node, 0.1 m apart, as that of a body of 25 m has."""
    field = target.require_field()
    values = np.ascontiguousarray(field.values[::CELLS, ::CELLS, ::CELLS])
    return replace(target, field=DistanceField(field.origin_m, CELLS * field.spacing_m, values))


def exact_frame() -> PmdFrame:
    """Return a frame of the mock-up whose ranges have no error."""
    config = PmdConfig()
    exposure = PmdEmulator(config, MOCKUP, seed=3).expose([TRUTH] * 4, sun_W_m2=np.zeros(3), frame=1)
    rays = RayGrid.pinhole(config.camera)
    depth_m = cast(rays, MOCKUP.triangles_m, TRUTH).range_m * rays.components[2]
    seen = np.isfinite(exposure.depth_m) & np.isfinite(depth_m)
    return PmdFrame(
        stamp_ns=0,
        frame_id="",
        depth_m=np.where(seen, depth_m, np.nan).astype(np.float32),
        amplitude=exposure.amplitude.copy(),
        camera=config.camera,
    )


def test_a_field_of_coarse_cells_does_not_shift_the_pose() -> None:
    body, seen = with_coarse_field(MOCKUP), exact_frame()
    points_m = TRUTH.inv().apply(points_of(seen))
    said_m = field_arrays(body)
    in_field = [sums_at(said_m, each, Planes.none(1))[1] for each in points_m[::50]]
    assert np.mean(in_field) > 0.004  # the field says that the surface lies outside
    found = JointTracker(JointConfig(), body, calibrated=True).track(seen, TRUTH)
    assert found.T_sensor_target is not None
    assert abs(found.range_bias_m) < 0.001
    assert np.linalg.norm(found.T_sensor_target.translation - TRUTH.translation) < 0.0005


def points_of(seen: PmdFrame) -> FloatArray:
    """Return the points of a frame, sensor axes, shape (N, 3), m."""
    rays = RayGrid.pinhole(seen.camera).components
    there = np.isfinite(seen.depth_m)
    points_m: FloatArray = (rays / rays[2] * seen.depth_m)[:, there].T
    return points_m


def sums_at(field: FieldArrays, point_m: FloatArray, planes: Planes) -> tuple[FloatArray, float]:
    """Return the sums of one point, seen from 2 m along +x, and its residual; weights are nearly 1."""
    pose = PoseArrays(
        np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]]), np.array([0.0, 0.0, 2.0])
    )
    place = np.ascontiguousarray((pose.R @ point_m + pose.t)[None])
    sums = no_sums()
    evidence = add_depth_points(sums, Points.equal(place), planes, State(pose, 0.0), field, 10.0)
    return sums, float(np.sqrt(evidence.squares_m2))


@pytest.mark.parametrize(("away_m", "of_plane"), [(0.01, True), (-0.06, True), (0.4, False)])
def test_a_plane_counts_unless_it_is_farther_than_the_field_says_by_more_than_a_cell(
    away_m: float, *, of_plane: bool
) -> None:
    shape = (12, 12, 12)
    field = field_arrays(
        replace(MOCKUP, field=DistanceField(np.full(3, -0.55), 0.1, np.full(shape, 0.05, np.float32)))
    )
    planes = Planes(np.array([[1.0, 0.0, 0.0]]), np.array([0.2]))
    sums, residual_m = sums_at(field, np.array((0.2 + away_m, 0.0, 0.0)), planes)
    assert residual_m == pytest.approx(abs(away_m) if of_plane else 0.0, abs=1e-9)
    # a field that is level tells no direction, so that the point has no residual
    assert information_of(sums, 7)[0, 0] == pytest.approx(1.0 if of_plane else 0.0, abs=0.01)
    assert gradient_of(sums, 7)[0] == pytest.approx(-away_m if of_plane else 0.0, abs=2e-3)


def sloping_depth_m(tilt_deg: float) -> np.ndarray:
    """Return the depth of a plane at 6 m, shape (172, 224), in a camera with a wide lens."""
    x, y = np.meshgrid((np.arange(224) - 111.5) / FX, (np.arange(172) - 85.5) / FX)
    slope = np.tan(np.radians(tilt_deg))
    return 6.0 / (1.0 - slope * (0.8 * x + 0.6 * y) / 2.0)


FX = 110.0


@pytest.mark.parametrize("tilt_deg", [0.0, 45.0, 65.0])
@pytest.mark.parametrize("noise_m", [0.0, 0.01])
def test_a_slope_is_no_noise(tilt_deg, noise_m):
    noise = noise_m * np.random.default_rng(5).standard_normal((172, 224))
    depth_m = (sloping_depth_m(tilt_deg) + noise).astype(np.float32)
    view = DepthView.of(Camera(width=224, height=172, fx=FX, fy=FX, cx=111.5, cy=85.5), 3)
    bright = np.full(depth_m.shape, 500, np.uint16)
    images = DepthImages(depth_m, bright, np.ones(depth_m.shape, np.float32))
    rays_z, pixels = view.coarse.components[2], CoarsePixels(3, 1)
    ranges = coarse_ranges(images, rays_z, pixels, 4.0 / FX)
    medians = noise_of_medians(depth_m, 3, 1, rays_z.shape, 4.0 / FX)
    inner = (slice(1, -1), slice(1, -1))
    of_mean, of_median = 1.06 * noise_m / 3.0, 1.25 * noise_m / 3.0
    assert np.median((ranges.sigma_m * rays_z)[inner]) == pytest.approx(of_mean, rel=0.06, abs=5e-4)
    assert np.median(medians[inner]) == pytest.approx(of_median, rel=0.06, abs=5e-4)


def test_an_outline_is_noise_since_no_face_is_so_steep():
    depth_m = np.where(np.arange(30) < 15, 6.0, 6.5) * np.ones((12, 1), np.float32)
    sigma_m = noise_of_medians(depth_m.astype(np.float32), 1, 0, (12, 30), 4.0 / 683.0)
    assert (sigma_m[:, 14:16] > 0.08).all()
    assert (sigma_m[:, :13] < 1e-6).all()
