import numpy as np

from rpod_analysis.report.wireframe import svg_path


def test_segments_that_follow_each_other_are_one_line():
    segments = np.array([[[0, 0], [1, 0]], [[1, 0], [2, 0]], [[5, 5], [6, 6]]], float)
    assert svg_path(segments) == "M0.0 0.0L1.0 0.0L2.0 0.0M5.0 5.0L6.0 6.0"
    assert svg_path(np.zeros((0, 2, 2))) == ""
