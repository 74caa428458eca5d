import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from rpod_view.shading import band, depth_colours, depth_mm, depth_span_m, ellipsoid, grey


def test_depths_are_millimetres_within_their_span_and_what_is_none_is_farthest():
    depth_m = np.array([[1.5, np.nan, 0.1], [2.5004, 100.0, 3.9996]], np.float32)
    np.testing.assert_array_equal(depth_mm(depth_m, (1.0, 4.0)), [[1500, 4000, 1000], [2500, 4000, 4000]])
    assert depth_mm(depth_m, (1.0, 100.0)).max() == 65_000


def test_a_negative_depth_is_near_not_far():
    depth_m = np.array([[-1.0, -0.0, np.nan, 2.0]], np.float32)
    np.testing.assert_array_equal(depth_mm(depth_m, (-1.0, 2.0)), [[0, 0, 2000, 2000]])
    assert depth_mm(depth_m, (-3.0, -1.0)).max() == 0


def test_the_span_of_depths_holds_them_and_moves_in_steps():
    depth_m = np.linspace(2.1, 4.4, 1000, dtype=np.float32)
    assert depth_span_m(depth_m) == (2.0, 4.5)
    assert depth_span_m(depth_m + 0.01) == (2.0, 4.5)
    assert depth_span_m(np.full(5, np.nan, np.float32)) == (0.0, 1.0)
    near_m, far_m = depth_span_m(np.full(5, 3.0, np.float32))
    assert near_m <= 3.0 < far_m


def test_tones_rise_with_the_amplitude_and_use_the_whole_scale():
    tones = grey(np.arange(10_000, dtype=np.uint16).reshape(100, 100)).ravel()
    assert (np.diff(tones.astype(int)) >= 0).all()
    assert (tones[0], tones[-1]) == (0, 255)
    assert grey(np.full((8, 8), 7, np.uint16)).max() == 0


def test_what_is_near_is_bright():
    colours = depth_colours(np.array([2.0, 3.0, 4.0, 9.0]), (2.0, 4.0)).astype(int)
    np.testing.assert_array_equal(colours[0], [253, 231, 37])
    np.testing.assert_array_equal(colours[2], [68, 1, 84])
    np.testing.assert_array_equal(colours[3], colours[2])
    assert colours[0].sum() > colours[1].sum() > colours[2].sum()


@given(
    st.lists(st.floats(1e-4, 2.0), min_size=3, max_size=3),
    st.lists(st.floats(-3.0, 3.0), min_size=3, max_size=3),
)
def test_an_ellipsoid_spans_three_sigma_of_its_covariance(sigmas, rotvec):
    axes = Rotation.from_rotvec(rotvec).as_matrix()
    covariance = axes @ np.diag(np.square(sigmas)) @ axes.T
    half, quaternion = ellipsoid(covariance)
    turned = Rotation.from_quat(quaternion).as_matrix()
    np.testing.assert_allclose(turned @ np.diag(half**2) @ turned.T, 9.0 * covariance, atol=1e-9)
    np.testing.assert_allclose(band(covariance), 3.0 * max(sigmas), rtol=1e-6)


def test_no_covariance_is_a_point():
    half, _ = ellipsoid(np.zeros((3, 3)))
    np.testing.assert_array_equal(half, 0.0)
    assert band(np.zeros((3, 3))) == 0.0
