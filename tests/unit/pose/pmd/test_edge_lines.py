"""Errors of edges that are the same along a line: lines of a target, and what they mean for a pose."""

import numpy as np
import pytest

from rpod_pose.pmd.joint.edge_lines import Lines, jackknife
from rpod_pose.pmd.joint.edge_model import EdgeModel
from rpod_target import load_target


def test_a_circle_is_one_line_and_a_box_has_twelve():
    target = load_target("mockup")
    edges = EdgeModel.of(target, spacing_m=0.02)

    def lines(part: str) -> int:
        return len(np.unique(edges.lines[edges.parts == target.parts.index(part)]))

    assert (lines("nose"), lines("box")) == (2, 12)
    assert lines("body") == 18 + 3  # three boundaries of foils on its front


def test_the_jackknife_finds_errors_that_the_samples_of_a_line_share():
    rng, lines, samples, sigma = np.random.default_rng(3), 40, 25, 0.2
    rows = rng.normal(size=(lines, 7))  # those of a line are equal
    informations = samples * np.einsum("li,lj->lij", rows, rows)
    covariance = np.linalg.inv(informations.sum(axis=0))
    found, moved = [], []
    for _ in range(300):
        shared = sigma * rng.normal(size=lines)
        step = covariance @ (samples * rows.T @ shared)
        moved.append(step)
        left = shared - rows @ step
        sums = Lines(-samples * left[:, None] * rows, informations, 0.0 * informations)
        found.append(jackknife(sums, covariance, samples=np.zeros((7, 7))))
    expected = np.cov(np.array(moved).T)
    told = (lines - 6) / lines
    ratio = np.trace(np.linalg.solve(told * expected, np.mean(found, axis=0))) / 7.0
    assert ratio == pytest.approx(1.2, abs=0.25)  # the jackknife is a little too large


def test_as_many_lines_as_unknowns_tell_nothing():
    rng = np.random.default_rng(5)
    rows, samples = rng.normal(size=(6, 7)), np.diag(np.arange(1.0, 8.0))
    informations = np.einsum("li,lj->lij", rows, rows)
    sums = Lines(rng.normal(size=(6, 7)), informations, 0.0 * informations)
    np.testing.assert_array_equal(jackknife(sums, np.eye(7), samples=samples), samples)
