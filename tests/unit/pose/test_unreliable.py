"""Unreliable parts of a target: what a frame shows of them is no evidence."""

import json

import numpy as np
import pytest
from pmd_frames import depth_frame
from scipy.spatial.transform import Rotation

from rpod_geometry.rays import RayGrid, cast
from rpod_pose.lidar.methods import ideal_scan
from rpod_pose.lidar.scan_pattern import ScanPattern
from rpod_pose.methods import methods_of
from rpod_pose.pmd.methods import masked
from rpod_pose.unreliable import UnreliableParts
from rpod_schemas.config.estimator import LidarInput
from rpod_schemas.poses import make_pose, pose_error
from rpod_target import TargetError, load_target

ANGLES_RAD = np.deg2rad(np.arange(-15.0, 15.1, 0.4))
PATTERN = ScanPattern(ANGLES_RAD, ANGLES_RAD, sigma_range_m=0.01)
PIECES = {"body": ([1.0, 1.4, 0.8], [0.0, 0.0, 0.0]), "box": ([0.4, 0.3, 0.5], [0.3, 0.2, 0.5])}
ARRAY = {"name": "array", "shape": "box", "size_m": [0.8, 2.0, 0.05], "material": "grey"}


@pytest.fixture(scope="module")
def load(tmp_path_factory):
    folder = tmp_path_factory.mktemp("targets")

    def load(name, roll_deg=0.0, unreliable=()):
        place = {"translation_m": [0.0, 1.75, 0.0], "euler_321_deg": [0.0, roll_deg, 0.0]}
        parts = [
            {
                "name": part,
                "shape": "box",
                "size_m": size,
                "material": "grey",
                "T_target_part": {"translation_m": at},
            }
            for part, (size, at) in PIECES.items()
        ]
        parts.append(ARRAY | {"T_target_part": place})
        document = {
            "name": name,
            "mass_kg": 50.0,
            "materials": {"grey": {"reflectivity": 0.5, "diffuse": 0.4, "f0": 0.02, "roughness": 0.3}},
            "parts": [part | {"unreliable": True} if part["name"] in unreliable else part for part in parts],
            "distance_field": {"spacing_m": 0.04},
        }
        file = folder / f"{name}.yaml"
        file.write_text(json.dumps(document))
        return load_target(file, cache=folder / "cache")

    return load


@pytest.fixture(scope="module")
def target(load):
    return load("doubted", unreliable=("array",))


POSE = make_pose(
    rotation=Rotation.from_euler("ZYX", [30.0, 35.0, 160.0], degrees=True), translation_m=(0.0, -0.5, 9.0)
)


def test_a_target_has_a_twin_without_its_unreliable_parts(target, load):
    assert target.parts == ("body", "box", "array")
    assert target.reliable is not None
    assert target.reliable.parts == ("body", "box")
    assert load("plain").reliable is None
    with pytest.raises(TargetError, match="no part is left without body, box, array"):
        load("nothing", unreliable=("body", "box", "array"))


def test_a_camera_loses_the_pixels_of_such_a_part_and_no_others(target):
    frame = depth_frame(target, POSE)
    parts = UnreliableParts(target, target.reliable)
    found = masked(frame, lambda points_m: parts.hit(points_m, POSE))
    hits = cast(RayGrid.pinhole(frame.camera), target.triangles_m, POSE)
    of_array = (hits.triangle >= 0) & (target.triangle_part[hits.triangle] == 2)
    lost = np.isfinite(frame.depth_m) & ~np.isfinite(found.depth_m)
    assert of_array.sum() > 3000
    assert (lost & of_array).sum() > 0.93 * of_array.sum()  # without those beside the body
    assert (lost & ~of_array).sum() == 0


def test_a_turned_array_moves_the_pose_only_where_it_is_relied_on(target, load):
    truth = load("turned", roll_deg=12.0)
    scan, _ = ideal_scan(truth, POSE, PATTERN)
    start = make_pose(
        rotation=POSE.rotation * Rotation.from_rotvec([0.02, -0.03, 0.02]),
        translation_m=POSE.translation + 0.03,
    )
    error_deg = {}
    for model in (target, load("plain")):
        found = methods_of(LidarInput(), model, PATTERN).tracker.track(scan, start).T_sensor_target
        assert found is not None
        error_deg[model.name] = np.rad2deg(np.linalg.norm(pose_error(POSE, found)[0]))
    assert error_deg["doubted"] < 0.3
    assert error_deg["plain"] > 3.0 * error_deg["doubted"]
