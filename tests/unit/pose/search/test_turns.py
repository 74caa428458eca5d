"""Which poses are the same modulo a target's exact symmetries."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from rpod_pose.search.face_turns import MOST, face_turns
from rpod_pose.search.round_turns import STEP_DEG, RoundTurns, round_turns
from rpod_pose.search.turns import Turns, matrices
from rpod_schemas.arrays import FloatArray
from rpod_target import Equivalence, load_target

ORIGIN = np.zeros(3)
HALF = Rotation.from_euler("z", 180.0, degrees=True).as_matrix()
NONE = np.zeros((0, 3, 3))
HALF_TURN = Turns(NONE, 0, NONE, NONE, RoundTurns.none(), Equivalence(np.stack((np.eye(3), HALF))))


@dataclass(frozen=True, eq=False)
class Pose:
    R: FloatArray
    t: FloatArray


def attitude(angle_deg, axis="x"):
    return Rotation.from_euler(axis, angle_deg, degrees=True).as_matrix()


@pytest.mark.parametrize(("angle_deg", "close"), [(0.0, True), (9.9, True), (10.1, False), (180.0, False)])
def test_attitudes_within_the_angle_are_close(angle_deg, close):
    (row,) = HALF_TURN.close(attitude(30.0)[None], attitude(30.0 + angle_deg)[None], 10.0)
    assert row.tolist() == [close]


def test_an_exact_symmetry_is_no_difference():
    start = attitude(30.0)
    (row,) = HALF_TURN.close(start[None], np.stack((start @ HALF, HALF @ start)), 10.0)
    assert row.tolist() == [True, False]


def test_of_close_poses_the_best_remains():
    poses = [Pose(attitude(angle_deg), ORIGIN) for angle_deg in (0.0, 4.0, 50.0, 48.0)]
    twin = Pose(poses[2].R @ HALF, ORIGIN)
    assert HALF_TURN.distinct([*poses, twin], 10.0) == [poses[0], poses[2]]


def test_no_pose_is_close_to_none():
    assert matrices([]).shape == (0, 3, 3)
    assert HALF_TURN.close(attitude(0.0)[None], matrices([]), 10.0).shape == (1, 0)
    assert HALF_TURN.distinct([], 10.0) == []


def prism_with_parts(folder):
    """Return a hexagonal prism with a panel and a box beside it, of which no symmetry is left."""
    prism = trimesh.creation.cylinder(radius=0.6, height=1.5, sections=6)
    panel = trimesh.creation.box((0.02, 0.8, 0.9))
    panel.apply_transform(trimesh.transformations.rotation_matrix(0.4, (0, 0, 1), (0.7, 1.0, 0.2)))
    panel.apply_translation((0.9, 0.7, 0.2))
    instrument = trimesh.creation.box((0.2, 0.25, 0.3)).apply_translation((0.1, -0.2, 0.9))
    trimesh.util.concatenate((prism, panel, instrument)).export(folder / "prism.stl")
    file = folder / "prism.yaml"
    file.write_text(
        "name: prism\nmass_kg: 80\n"
        "materials: {plain: {reflectivity: 0.4, diffuse: 0.4, f0: 0.02, roughness: 0.3}}\n"
        "parts: [{name: all, shape: mesh, file: prism.stl, metres_per_unit: 1, material: plain}]\n"
    )
    return load_target(file, cache=folder)


def test_the_turns_of_a_body_are_compared_though_its_parts_leave_no_symmetry(tmp_path):
    target = prism_with_parts(tmp_path)
    turns = Turns.of(target)
    assert not target.turns()
    sixths = [Rotation.from_euler("z", 60.0 * k, degrees=True) for k in range(1, 6)]
    halves = [
        Rotation.from_rotvec(np.pi * np.array([np.cos(a), np.sin(a), 0.0])) for a in np.pi * np.arange(6) / 6
    ]
    for turn in (*sixths, *halves):
        angles_deg = [
            np.degrees((Rotation.from_matrix(other).inv() * turn).magnitude()) for other in turns.compared
        ]
        assert min(angles_deg) < 5.0
    assert len(turns.compared) <= turns.declared + MOST


def test_a_body_whose_faces_all_look_alike_has_no_turn_of_faces():
    target = load_target("hexagonal-body")
    assert all(
        not Turns.of(target).close(np.eye(3)[None], turn[None], 1.0).any() for turn in Turns.of(target).faces
    )
    flat = replace(target, normals=np.tile([0.0, 0.0, 1.0], (len(target.normals), 1)))
    assert face_turns(flat) == []


def shaped(*parts):
    """Return a target whose surface is that of several meshes."""
    mesh = trimesh.util.concatenate(parts)
    return replace(load_target("hexagonal-body"), triangles_m=mesh.triangles, normals=mesh.face_normals)


def drum_with_parts():
    """Return a drum beside the origin, with a horn on its end and thrusters around it, without a symmetry."""
    parts = [trimesh.creation.cylinder(radius=0.6, height=1.2, sections=24)]
    parts.append(trimesh.creation.box((0.5, 0.3, 0.4)).apply_translation((0.1, 0.05, 0.8)))
    for angle in np.radians((0.0, 90.0, 180.0)):
        nozzle = trimesh.creation.box((0.2, 0.1, 0.1)).apply_translation((0.7, 0.0, -0.3))
        parts.append(nozzle.apply_transform(trimesh.transformations.rotation_matrix(angle, (0, 0, 1))))
    return shaped(*(part.apply_translation((0.3, -0.2, 0.0)) for part in parts))


def test_a_drum_with_parts_turns_about_its_axis_wherever_that_is():
    turns, centre_m = round_turns(drum_with_parts())
    assert len(turns) == 360.0 / STEP_DEG - 1
    axis = Rotation.from_matrix(turns[0]).as_rotvec(degrees=True) / STEP_DEG
    assert np.abs(axis[2]) == pytest.approx(1.0, abs=1e-3)
    assert centre_m[:2] == pytest.approx((0.3, -0.2), abs=0.03)


def test_a_body_with_flat_sides_or_a_part_of_a_round_one_has_no_round_axis():
    box = trimesh.creation.box((1.0, 1.0, 2.0))
    prism = trimesh.creation.cylinder(radius=0.6, height=1.5, sections=6)
    drum = trimesh.creation.cylinder(radius=0.6, height=1.5, sections=24)
    half = drum.submesh([np.flatnonzero(drum.triangles_center[:, 0] > 0.0)], append=True)
    assert len(round_turns(shaped(drum)).turns)
    for other in (box, box.subdivide().subdivide(), prism, half):
        assert not len(round_turns(shaped(other)).turns)
