"""A fit's pose with the wiggling of an uncalibrated camera among its unknowns.

The bias is an error that all ranges share. Wiggling also stretches and bends what the ranges show, as another
attitude does, so that it must not be averaged out. Its waves' amplitudes have the camera's standard deviation
as a prior; they are eliminated from the normal equations (Schur's complement), which leaves the information
about pose and bias that is free of them.
"""

from typing import NamedTuple

import numpy as np

from rpod_pose.pmd.joint.fit import JointFit, JointProblem, align, last_shares, wave_equations
from rpod_pose.pmd.joint.wiggling import waves
from rpod_pose.registration.field_alignment import Points
from rpod_schemas.arrays import FloatArray


class Waves(NamedTuple):
    """The wiggling of a frame, linearised at a fit."""

    amplitudes_m: FloatArray
    """Likeliest amplitude of each wave, together with the pose, shape (W,), m."""
    lost: FloatArray
    """Information about (dtau, dtheta, bias) that is lost since the wiggling is unknown, shape (7, 7)."""


def evened(
    problem: JointProblem, fit: JointFit, weak: FloatArray, frequencies_hz: FloatArray, sigma_m: float
) -> JointFit:
    """Return the fit with the wiggling among the unknowns; unchanged if nothing can be told of it.

    Args:
        problem: the frame whose fit it is.
        fit: the pose without wiggling, at which all is linearised.
        weak: prior information about (dtau, dtheta, bias), shape (7, 7).
        frequencies_hz: modulation frequencies, shape (F,), Hz; with several, the distance is their mean.
        sigma_m: standard deviation of the wiggling at any range, m.
    """
    places_m, trust = problem.points
    if not len(places_m) or not len(frequencies_hz) or not sigma_m > 0.0:
        return fit
    range_m = np.linalg.norm(places_m, axis=1)
    wave = waves(range_m, frequencies_hz)
    prior = np.eye(len(wave)) * len(frequencies_hz) / sigma_m**2
    found = _waves(problem, fit, wave, prior, weak)
    if found is None:
        return fit
    shares = 1.0 - found.amplitudes_m @ wave / range_m
    problem = problem._replace(points=Points(np.ascontiguousarray(places_m * shares[:, None]), trust))
    fit = align(problem, fit.state)
    found = _waves(problem, fit, wave, prior, weak)
    return fit if found is None else fit._replace(information=fit.information - found.lost)


def _waves(
    problem: JointProblem, fit: JointFit, wave: FloatArray, prior: FloatArray, weak: FloatArray
) -> Waves | None:
    """Return the wiggling at a fit; None if the sums are not finite."""
    with_pose, own, gradient = wave_equations(problem, fit.state, last_shares(problem, fit), wave)
    own += prior
    information = fit.information + weak
    if not (np.isfinite(own).all() and np.isfinite(with_pose).all() and np.isfinite(information).all()):
        return None
    lost = with_pose.T @ np.linalg.solve(own, with_pose)
    of_waves = own - with_pose @ np.linalg.solve(information, with_pose.T)
    return Waves(-np.linalg.solve(of_waves, gradient), lost)
