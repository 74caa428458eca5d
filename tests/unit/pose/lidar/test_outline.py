"""The rays beside the outline: how far from it they are, and what their results say."""

import numpy as np
import pytest
from lidar_scans import load, random_pose, scan_at, tracker

from rpod_geometry.rays import cast
from rpod_pose.lidar.outline.places import MOST_CROSSINGS
from rpod_pose.lidar.outline.steps import Scene, outline_steps
from rpod_pose.lidar.scan_likelihood import Rays
from rpod_pose.registration.lie_group import PoseArrays, stepped
from rpod_pose.registration.surface_model import Edges, cast_faces
from rpod_schemas.poses import pose_of

MESH = "envisat-mesh"


def steps_at(pose, scan, target="envisat-bulky", copies=1):
    view, model, faces = tracker(target).view, tracker(target).model, tracker(target).surface.faces
    ends_m, beside = faces.edges
    edges = Edges(np.repeat(ends_m, copies, axis=0), np.repeat(beside, copies, axis=0))
    rays = Rays(view.grid.arrays, faces._replace(edges=edges), view.hits.range_m, view.hits.triangle)
    cast_faces(view.grid.arrays, faces, pose.R, pose.t, view.hits.arrays)
    return outline_steps(Scene(view.seen(scan).range_m, pose, rays, model.assumed, 0))


@pytest.mark.parametrize("target", ["envisat-bulky", MESH])
def test_at_the_right_pose_the_rays_are_on_the_side_that_they_show(target):
    for seed in range(6):
        T = random_pose(seed, 30.0)
        steps = steps_at(PoseArrays.of(T), scan_at(T, target, frame=seed), target)
        assert steps.number > 40
        distance, odds = steps.distance_m[: steps.number], steps.odds[: steps.number]
        told = np.abs(odds) > 1.0
        assert told.mean() > 0.8
        assert (np.sign(distance) == np.sign(odds))[told].mean() > 0.9


def test_the_distances_follow_a_small_motion_as_their_derivatives_say():
    T = random_pose(2, 30.0)
    pose, scan = PoseArrays.of(T), scan_at(T, frame=2)
    here = steps_at(pose, scan)
    step = np.array((0.02, -0.03, 0.02, 0.0, 0.0, 0.0))
    there = steps_at(stepped(pose, step), scan)
    off_m, moved_m = [], []
    for row, distance_m in zip(here.rows, here.distance_m, strict=True):
        alike = np.linalg.norm(there.rows[:, :3] - row[:3], axis=1) < 0.02
        moved_m.append(row @ step)
        off_m.append(np.abs(there.distance_m[alike] - distance_m - row @ step).min(initial=1.0))
    assert np.median(off_m) < 0.01
    assert np.median(off_m) < 0.5 * np.median(np.abs(moved_m))


def test_a_shifted_pose_is_contradicted_on_the_side_to_which_it_was_shifted():
    T = random_pose(3, 30.0)
    shift_m = np.array((0.4, 0.0, 0.0))
    shifted = pose_of(T.rotation.as_matrix(), T.translation + shift_m)
    steps = steps_at(PoseArrays.of(shifted), scan_at(T, frame=3))
    distance, odds = steps.distance_m[: steps.number], steps.odds[: steps.number]
    wrong = (np.sign(distance) != np.sign(odds)) & (np.abs(odds) > 1.0)
    assert wrong.sum() > 5
    back = -(steps.rows[: steps.number, :3] @ (T.rotation.as_matrix().T @ shift_m))
    improving = np.sign(back) == np.sign(odds)
    assert np.abs(back)[wrong & improving].sum() > 0.9 * np.abs(back)[wrong].sum()


def test_a_target_beside_the_field_of_view_has_no_outline_in_it():
    T = pose_of(np.eye(3), np.array((100.0, 0.0, 10.0)))
    assert not (cast(tracker().view.grid, load("envisat-bulky").triangles_m, T).triangle >= 0).any()
    assert steps_at(PoseArrays.of(T), scan_at(random_pose(0))).number == 0


def test_more_edges_between_two_rays_than_there_is_memory_at_first_are_all_compared():
    T = random_pose(4, 30.0)
    once, often = (
        steps_at(PoseArrays.of(T), scan_at(T, frame=4), copies=copies) for copies in (1, 2 * MOST_CROSSINGS)
    )
    assert once.number > 40
    np.testing.assert_array_equal(once.rows, often.rows)
    np.testing.assert_array_equal(once.distance_m, often.distance_m)
