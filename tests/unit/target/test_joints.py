"""Joints of a target: declared in its file, and the target at given angles."""

import json

import numpy as np
import pytest

from rpod_target import TargetError, load_target, posed
from rpod_target.joints import sampled

BODY = {"name": "body", "shape": "box", "size_m": [1.0, 1.4, 0.8], "material": "grey"}
ARRAY = {"name": "array", "shape": "box", "size_m": [0.8, 2.0, 0.1], "material": "grey"}
ANGLE_RAD = np.deg2rad(40.0)


@pytest.fixture(scope="module")
def load(tmp_path_factory):
    folder = tmp_path_factory.mktemp("targets")

    def load(name, roll_deg=0.0, variation="", **joint):
        place = {"translation_m": [0.0, 1.75, 0.0], "euler_321_deg": [0.0, roll_deg, 0.0]}
        array = ARRAY | {"T_target_part": place}
        joints = {"array": {"axis": [0, 2, 0], "origin_m": [0, 0, 0], "limits_deg": [-90, 90]} | joint}
        document = {
            "name": name,
            "mass_kg": 50.0,
            "materials": {"grey": {"reflectivity": 0.5, "diffuse": 0.4, "f0": 0.02, "roughness": 0.3}},
            "parts": [BODY, array | {"joint": "array"} if joint else array],
            "distance_field": {"spacing_m": 0.04},
        } | ({"joints": joints} if joint else {})
        file = folder / f"{name}.yaml"
        file.write_text(json.dumps(document))
        return load_target(f"{file}{variation}", cache=folder / "cache")

    return load


@pytest.fixture(scope="module")
def jointed(load):
    return load("jointed", most_rate_deg_s=0.5)


def test_a_joint_has_its_parts_apart_from_the_fixed_ones(jointed):
    (joint,) = jointed.joints
    assert (jointed.fixed.parts, joint.moving.parts) == (("body",), ("array",))
    assert np.allclose(joint.axis, [0.0, 1.0, 0.0])
    assert np.allclose(np.rad2deg([*joint.limits_rad, joint.rate_rad_s]), [-90.0, 90.0, 0.5])
    assert joint.lever_m == pytest.approx(np.hypot(0.4, 0.05))


def test_at_an_angle_the_target_is_the_one_whose_file_has_the_part_turned(jointed, load):
    turned, same = posed(jointed, {"array": ANGLE_RAD}), load("turned", roll_deg=40.0)
    assert np.allclose(np.sort(turned.triangles_m, axis=0), np.sort(same.triangles_m, axis=0))
    assert np.allclose(np.linalg.norm(turned.normals, axis=1), 1.0)
    points_m = same.model_points_m + 0.05 * same.model_normals
    off_m = sampled(turned.require_field(), points_m) - sampled(same.require_field(), points_m)
    assert np.abs(off_m).max() < 0.04
    between_m = [[0.0, 1.3, 0.6], [0.3, 2.2, -0.5]]  # beyond the grid of the body
    for place in between_m:
        nearest_m = min(np.linalg.norm(same.model_points_m - place, axis=1))
        assert sampled(turned.require_field(), np.array([place]))[0] == pytest.approx(nearest_m, abs=0.06)
    assert turned.digest != posed(jointed, {}).digest != jointed.digest
    assert posed(same, {"array": 1.0}) is same


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"axis": [0, 0, 0]}, "must not be zero"),
        ({"limits_deg": [20, -20]}, r"is \[20, -20\]; it needs the least angle first"),
        ({"limits_deg": [-200, 200]}, "at most a turn apart"),
        ({"variation": "@bent=5deg", "most_rate_deg_s": 1.0}, "neither @bent nor @missing"),
    ],
)
def test_a_joint_that_cannot_be_is_refused(load, change, reason):
    with pytest.raises(TargetError, match=reason):
        load("refused", **change)
