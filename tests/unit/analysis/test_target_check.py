"""What a check says of a target: openings, straight edges, expected accuracy, and its picture."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
import yaml
from scipy.spatial.transform import Rotation

from rpod_analysis.target_check import accuracy, check
from rpod_analysis.target_check.accuracy import RangeAccuracy, SensorAccuracy, _stated, expected_accuracy
from rpod_analysis.target_check.check import check_target, described_frame
from rpod_analysis.target_check.edges import straight_edges
from rpod_analysis.target_check.holes import openings
from rpod_analysis.target_check.page import render_views, write_page
from rpod_pose.belief import Belief
from rpod_pose.ports import Registration
from rpod_schemas.poses import make_pose
from rpod_schemas.types import Source
from rpod_target import NO_SYMMETRY, Equivalence, Symmetry, Target, load_target


def built(mesh: trimesh.Trimesh, folder: Path) -> Target:
    mesh.export(folder / "hull.stl")
    document = {
        "name": "hull",
        "mass_kg": 10.0,
        "materials": {"paint": {"reflectivity": 0.5, "diffuse": 0.4, "f0": 0.02, "roughness": 0.3}},
        "parts": [
            {"name": "hull", "shape": "mesh", "file": "hull.stl", "metres_per_unit": 1.0, "material": "paint"}
        ],
        "distance_field": {"spacing_m": 0.1, "margin_m": 0.3},
        "model_points": 100,
    }
    (folder / "hull.yaml").write_text(yaml.safe_dump(document))
    return load_target(folder / "hull.yaml", cache=folder / "cache")


def test_a_closed_box_has_no_opening_and_twelve_straight_edges(tmp_path: Path) -> None:
    target = built(trimesh.creation.box((2.0, 1.0, 0.5)).subdivide(), tmp_path)
    assert openings(target) == []
    edges = straight_edges(target)
    assert len(edges) == 12
    assert [edge.length_m for edge in edges[:4]] == pytest.approx([2.0] * 4)
    assert edges[0].angle_deg == pytest.approx(90.0)
    assert edges[0].seen_up_to_m["pmd"] > edges[0].seen_up_to_m["lidar"]


def test_a_check_tells_size_parts_materials_mass_field_edges_and_accuracy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(check, "try_methods", lambda *_, **__: ())  # takes 20 s
    monkeypatch.setattr(check, "checked_symmetries", lambda _: [])
    told = json.loads(
        json.dumps(check_target(built(trimesh.creation.box((2.0, 1.0, 0.5)), tmp_path)).document())
    )
    assert told["size"]["sides_m"] == pytest.approx([2.0, 1.0, 0.5])
    assert told["size"]["longest_side_m"] == pytest.approx(2.0)
    assert told["triangles"] == 12
    (part,), (material,) = told["parts"], told["materials"]
    assert (part["name"], part["triangles"], part["materials"]) == ("hull", 12, ["paint"])
    assert part["area_m2"] == pytest.approx(7.0)
    assert (material["name"], material["looks"], material["area_share"]) == ("paint", "white", 1.0)
    about_m = 10.0 / 12.0 * np.array((1.0 + 0.25, 4.0 + 0.25, 4.0 + 1.0))
    assert sorted(told["mass"]["principal_moments_kg_m2"]) == pytest.approx(sorted(about_m), rel=1e-3)
    field = told["distance_field"]
    assert field["megabytes"] == pytest.approx(np.prod(field["nodes"]) * 4e-6, rel=0.01)
    assert field["volume_inside_m3"] == pytest.approx(19 * 9 * 4 * 0.1**3)  # nodes within the box
    assert told["edges"] == 12
    for sensor in told["accuracy"]:
        seen = told["edges_seen"][sensor["sensor"]]
        assert [float(range_m) for range_m in seen] == pytest.approx(
            [at["range_m"] for at in sensor["ranges"]], rel=1e-3
        )
        assert list(seen.values()) == sorted(seen.values(), reverse=True)
        assert all(at["points"] >= 0 and (at["sigma_position_m"] or 1.0) > 0.0 for at in sensor["ranges"])


def test_the_page_has_whole_millimetres_for_large_errors(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(check, "try_methods", lambda *_, **__: ())
    monkeypatch.setattr(check, "checked_symmetries", lambda _: [])
    far = RangeAccuracy(20.0, 8, 0.1358, 1.0), RangeAccuracy(30.0, 6, None, None)
    monkeypatch.setattr(check, "expected_accuracy", lambda _: (SensorAccuracy("lidar", far),))
    target = built(trimesh.creation.box((2.0, 1.0, 0.5)), tmp_path)
    page = write_page(target, check_target(target), tmp_path).page.read_text("utf-8")
    assert ">136</td>" in page
    assert page.count(">no pose</td>") == 2


def test_a_declared_symmetry_that_the_surface_does_not_have_is_doubted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(check, "try_methods", lambda *_, **__: ())
    monkeypatch.setattr(check, "checked_symmetries", lambda _: [])
    right, wrong = (Symmetry((1.0, 0.0, 0.0), order, exact=True) for order in (2, 7))
    target = built(trimesh.creation.box((2.0, 1.0, 0.5)), tmp_path)
    found = check_target(replace(target, symmetries=(right, wrong)))
    assert found.declared_symmetries[0]["share"] > 0.98
    (doubt,) = found.doubts
    assert "about (1.000, 0.000, 0.000), every 51.43 deg, after which only" in doubt
    assert "count as equal; correct it or take it out" in doubt


def test_a_part_whose_name_ends_as_that_of_a_back_is_no_back(tmp_path: Path) -> None:
    mesh = trimesh.creation.box((2.0, 1.0, 0.5))
    mesh.update_faces(~(mesh.triangles[:, :, 2] == 0.25).all(axis=1))
    target = built(mesh, tmp_path)
    (opening,) = openings(replace(target, parts=("panel-back", "panel-back-back")))
    assert opening.parts == ("panel-back",)


def test_an_opening_is_told_with_its_place(tmp_path: Path) -> None:
    mesh = trimesh.creation.box((2.0, 1.0, 0.5))
    mesh.update_faces(~(mesh.triangles[:, :, 2] == 0.25).all(axis=1))
    (opening,) = openings(built(mesh, tmp_path))
    assert opening.parts == ("hull",)
    assert opening.centre_m == pytest.approx((0.0, 0.0, 0.25))
    assert (opening.edges, opening.length_m, opening.extent_m) == (4, pytest.approx(6.0), pytest.approx(2.0))


def test_the_accuracy_is_that_of_the_least_known_direction_but_a_free_one() -> None:
    pose = make_pose(rotation=Rotation.from_euler("y", 90.0, degrees=True), translation_m=[0.0, 0.0, 5.0])
    covariance = np.diag([1e-4, 4e-4, 1e-4, 1e-4, 1e-6, 3.0])  # the angle about the sensor's x axis is free
    covariance[3:, 3:] = covariance[3:, 3:][::-1, ::-1]
    found = Registration(Source.LIDAR, pose, belief=Belief(), covariance=covariance)
    free = Equivalence.of([Symmetry((0.0, 0.0, 1.0), 2, exact=True, continuous=True)])
    assert _stated(found, free) == pytest.approx((0.02, np.degrees(0.01)))
    assert _stated(found, NO_SYMMETRY)[1] == pytest.approx(np.degrees(np.sqrt(3.0)))
    assert _stated(None, free) == (np.inf, np.inf)
    assert _stated(Registration.none(Source.LIDAR, "few returns"), free) == (np.inf, np.inf)


def test_the_outline_of_a_plate_tells_how_it_has_moved_in_its_plane(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(accuracy, "_SHARES", (1.5,))
    (lidar, *_) = expected_accuracy(built(trimesh.creation.box((2.0, 1.5, 0.001)), tmp_path))
    close = lidar.ranges[0]
    assert close.points > 500
    assert 1e-4 < (close.sigma_position_m or np.inf) < 0.02
    assert (close.sigma_attitude_deg or np.inf) < 1.0


def test_the_picture_shows_the_target_and_its_edges(tmp_path: Path) -> None:
    image = render_views(built(trimesh.creation.box((2.0, 1.0, 0.5)), tmp_path))
    assert image.shape == (840, 1260, 3)
    red = (image[..., 2].astype(int) - image[..., 0]) > 80
    for row in (0, 420):
        for column in (0, 420, 840):
            assert red[row : row + 420, column : column + 420].sum() > 100


def test_a_frame_is_told_with_its_place_its_attitude_and_its_distance_from_the_surface(
    tmp_path: Path,
) -> None:
    adapter = make_pose(
        rotation=Rotation.from_euler("ZYX", [90.0, 0.0, 0.0], degrees=True), translation_m=(1.2, 0, 0)
    )
    target = replace(built(trimesh.creation.box((2.0, 1.0, 0.5)), tmp_path), frames={"adapter": adapter})
    facts = described_frame(target, "adapter")
    assert facts.place_m == (1.2, 0.0, 0.0)
    assert facts.euler_321_deg == pytest.approx((90.0, 0.0, 0.0))
    assert facts.from_surface_m == pytest.approx(0.2)
