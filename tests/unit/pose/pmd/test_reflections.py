import numpy as np
import pytest

from rpod_pose.pmd.joint.check.frame_check import longer_m
from rpod_pose.pmd.joint.check.reflections import reflected_m
from rpod_pose.pmd.rendering import RenderingArrays
from rpod_pose.registration.lie_group import PoseArrays
from rpod_target import load_target


def test_a_convex_body_reflects_nothing_onto_itself() -> None:
    assert reflected_m(load_target("hexagonal-body")).max() == pytest.approx(0.0, abs=1e-3)


def test_in_a_corner_a_range_may_be_longer_by_the_share_of_the_wall_times_its_distance() -> None:
    target = load_target("mockup")
    longer = reflected_m(target)
    front = (target.normals[:, 0] > 0.99) & np.isclose(target.triangles_m[:, :, 0], 0.0).all(axis=1)
    rear = target.normals[:, 0] < -0.99
    plain = rear & np.isclose(target.triangles_m[:, :, 0], -0.8).all(axis=1)
    assert front.any()
    assert plain.any()
    assert longer[front].max() > 0.01  # cone, box and thrusters stand on the front face
    assert longer[plain].max() == pytest.approx(0.0, abs=1e-3)
    assert longer.max() < 2.0 * target.radius_m


def test_light_at_an_angle_makes_the_reflection_count_more() -> None:
    triangle = np.array([[[-9.0, -9.0, 2.0], [0.0, 9.0, 2.0], [9.0, -9.0, 2.0]]])
    shown = np.array([[0, -1], [0, 0]], np.int32)
    ray = np.array((np.sqrt(0.75), 0.0, 0.5))  # 60 deg from the face's normal
    rays = np.empty((3, 2, 2))
    rays[:] = np.array((0.0, 0.0, 1.0))[:, None, None]
    rays[:, 1, 1] = ray
    pose = PoseArrays(np.eye(3), np.zeros(3))
    rendered = RenderingArrays(np.ones((2, 2), np.float32), shown, rays, 1, triangle, pose)
    assert longer_m(rendered, 0, 0, np.array([0.1])) == pytest.approx(0.1)
    assert longer_m(rendered, 1, 1, np.array([0.1])) == pytest.approx(0.2)
    assert longer_m(rendered, 0, 1, np.array([0.1])) == 0.0
    assert longer_m(rendered, 0, 0, np.empty(0)) == 0.0
