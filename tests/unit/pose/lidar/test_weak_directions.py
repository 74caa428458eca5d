"""First poses along motions that the faces hardly tell: a half shell turns about its axis."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_geometry.rays import RayGrid, cast
from rpod_pose.lidar import acquire
from rpod_pose.lidar.posterior.weak_directions import MOTIONS, walked, weakest_motions
from rpod_pose.ports import Outcome
from rpod_schemas.poses import make_pose
from rpod_schemas.types import LidarInfo, LidarScan
from rpod_target import load_target

RADIUS_M = 2.0
AROUND_Z = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0 / RADIUS_M])
ANGLES = np.radians(np.linspace(-20.0, 20.0, 41))
INFO = LidarInfo(azimuth_rad=ANGLES, elevation_rad=ANGLES, scan_time_s=0.1, sigma_range_m=0.01)


def test_a_body_of_revolution_turns_first():
    """Its normals lie on a cone, and meet the axis half a metre beside the origin."""
    angles = np.linspace(-0.8, 0.8, 50)
    normals = np.column_stack((np.cos(angles), np.sin(angles), np.full(50, 0.2)))
    places = np.column_stack((np.cos(angles) + 0.5, np.sin(angles), np.linspace(-1.0, 1.0, 50)))
    rows = np.column_stack((normals, np.cross(places, normals)))
    motion, *others = weakest_motions(rows.T @ rows, RADIUS_M)
    assert len(others) == MOTIONS - 1
    turned = RigidTransform.from_exp_coords(np.roll(motion, 3))
    axis = motion[3:] / np.linalg.norm(motion[3:])
    np.testing.assert_allclose(abs(axis[2]), 1.0, atol=0.02)
    np.testing.assert_allclose(turned.apply([0.5, 0.0, 0.0]), [0.5, 0.0, 0.0], atol=0.02)


@pytest.mark.parametrize(("likely_deg", "steps"), [(0.0, 0), (30.0, 6), (1e3, 24)])
def test_a_motion_is_followed_while_it_is_likely_and_to_its_budget(likely_deg: float, steps: int):
    found = walked(
        AROUND_Z,
        RADIUS_M * np.radians(10.0),
        RADIUS_M,
        lambda step: np.degrees(abs(step[5])) < likely_deg + 1.0,
    )
    assert len(found) == steps
    assert not any(step[:3].any() for step in found)


def test_a_motion_ends_at_half_a_turn_and_at_the_size_of_the_target():
    half_a_turn = walked(AROUND_Z, RADIUS_M * np.pi / 5.5, RADIUS_M, lambda _: True)
    assert len(half_a_turn) == 10
    along = walked(np.eye(6)[0], 0.99, RADIUS_M, lambda _: True)
    assert max(step[0] for step in along) == pytest.approx(4 * 0.99)


def half_shell(folder):
    """Return a half cylinder of 2.5 m with a closed end, as an open mesh."""
    angle = np.radians(np.linspace(0.0, 180.0, 21))
    rim = np.column_stack((0.8 * np.cos(angle), 0.8 * np.sin(angle)))
    corners = [(*place, z) for z in (0.0, 1.8) for place in rim] + [(0.0, 0.4, 2.5)]
    faces = [
        face for i in range(20) for face in ((i, i + 1, i + 22), (i, i + 22, i + 21), (i + 21, i + 22, 42))
    ]
    lines = ["v {} {} {}".format(*corner) for corner in corners]
    lines += ["f {} {} {}".format(*(i + 1 for i in face)) for face in faces]
    (folder / "shell.obj").write_text("\n".join(lines) + "\n")
    (folder / "shell.yaml").write_text(
        "name: shell\nmass_kg: 100.0\nmass_spread: surface\n"
        "materials: {plain: {reflectivity: 0.35, diffuse: 0.35, f0: 0.02, roughness: 0.3}}\n"
        "parts: [{name: shell, shape: mesh, file: shell.obj, metres_per_unit: 1.0, material: plain}]\n"
        "distance_field: {}\n"
    )
    return load_target(str(folder / "shell.yaml"))


def test_a_half_shell_is_found_at_the_turn_that_its_rims_show(tmp_path):
    """An alignment ends 10 deg off: the likelihood has an optimum at every few degrees."""
    target, grid = half_shell(tmp_path), RayGrid.azimuth_elevation(ANGLES, ANGLES)
    generator = np.random.default_rng(10)
    about = Rotation.from_rotvec(generator.normal(0.0, 0.25, 3))
    turns_deg = [90.0 + generator.uniform(-60.0, 60.0), -60.0 + 40.0 * generator.random()]
    truth = make_pose(
        rotation=about * Rotation.from_euler("YX", turns_deg, degrees=True),
        translation_m=[0.0, 0.0, generator.uniform(6.0, 10.0)],
    )
    range_m = cast(grid, target.triangles_m, truth).range_m
    range_m = np.where(
        np.isfinite(range_m), range_m + generator.normal(0.0, INFO.sigma_range_m, range_m.shape), np.nan
    )
    points_m = (range_m[..., None] * grid.directions).astype(np.float32)
    found = acquire(LidarScan(stamp_ns=0, frame_id="", points_m=points_m), target, INFO)
    assert found.outcome is Outcome.ACCEPTED
    assert np.degrees((truth.inv() * found.pose).rotation.magnitude()) < 2.0
