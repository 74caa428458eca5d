"""Errors of edges that are the same along a line: lines of a target, and what they mean for a pose."""

import numpy as np
import pytest

from rpod_pose.pmd.joint.edge_lines import Groups, Lines, jackknife, shared_errors
from rpod_pose.pmd.joint.edge_model import EdgeModel
from rpod_pose.pmd.joint.uncertainty import inverse_curvature
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


def test_errors_of_lines_and_of_tiles_add_up():
    """40 lines in 30 tiles, each with errors of its own: both are found together, and neither alone."""
    rng, lines, tiles = np.random.default_rng(7), 40, 30
    of_line, of_tile = np.divmod(np.arange(lines * tiles), tiles)
    rows = rng.normal(size=(lines, 7))[of_line] + rng.normal(size=(tiles, 7))[of_tile]
    informations = np.einsum("gi,gj->gij", rows, rows)
    covariance, none = np.linalg.inv(informations.sum(axis=0)), np.zeros((7, 7))
    moved, found, by_line = [], [], []
    for _ in range(100):
        shared = 0.2 * rng.normal(size=lines)[of_line] + 0.2 * rng.normal(size=tiles)[of_tile]
        moved.append(covariance @ rows.T @ shared)
        left = shared - rows @ moved[-1]
        both = Lines(-left[:, None] * rows, informations, 0.0 * informations)
        groups = Groups(both, both.summed(of_line), both.summed(of_tile))
        found.append(np.trace(shared_errors(groups, covariance, samples=none)))
        by_line.append(np.trace(jackknife(groups.lines, covariance, samples=none)))
    expected = np.trace(np.cov(np.array(moved).T))
    assert np.mean(found) == pytest.approx(expected, rel=0.25)
    assert np.mean(by_line) < 0.8 * np.mean(found)


def test_a_robust_minimum_moves_as_far_as_the_curvature_of_its_loss_says():
    """Geman and McClure's loss of residuals as large as its scale: weights tell a third of the variance."""
    rng, number, scale2 = np.random.default_rng(11), 4000, 1.0
    residuals = rng.normal(size=(400, number))
    ends = np.zeros(400)
    for _ in range(60):
        weights = (scale2 / (scale2 + (residuals - ends[:, None]) ** 2)) ** 2
        ends = (weights * residuals).sum(axis=1) / weights.sum(axis=1)
    share = scale2 / (scale2 + residuals[0] ** 2)
    information, bend = (share**2).sum(), (4.0 * share**2 * (1.0 - share)).sum()
    told = inverse_curvature(np.diag([information]), np.diag([bend]))[0, 0]
    pulls = ((share**2 * residuals[0]) ** 2).sum()
    assert told**2 * pulls == pytest.approx(ends.var(), rel=0.25)
    assert information**-2 * pulls < 0.4 * ends.var()


def test_a_loss_that_bends_away_counts_as_a_tenth_of_its_weights():
    found = inverse_curvature(np.diag([4.0, 2.0]), np.diag([8.0, 1.0]))
    np.testing.assert_allclose(found, np.diag([10.0 / 4.0, 1.0]))
