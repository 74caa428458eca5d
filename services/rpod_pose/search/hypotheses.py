"""The rivals of a search's best pose: the other poses that explain the measurement."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import softmax

from rpod_pose.belief import NOISE_M, SYMMETRY, Belief, Rival
from rpod_pose.ports import Registration
from rpod_pose.search.turns import Placed
from rpod_schemas.arrays import FloatArray
from rpod_schemas.poses import pose_of
from rpod_schemas.types import BeliefLevel
from rpod_target import Equivalence

NEGLIGIBLE = 1e-3
"""Least weight of a listed rival. Numerics: the omitted ones hardly change the weights of the others."""


def rivals(poses: Sequence[Placed], log_likelihoods: FloatArray, exact: Equivalence) -> tuple[Rival, ...]:
    """Return the other poses, besides the best one, that explain a measurement, likeliest first.

    Args:
        poses: poses of the target, best first.
        log_likelihoods: log likelihoods of the measurement under the poses, shape (N,).
        exact: the target's exact symmetries; each pose is listed with all of its equivalent poses.
    """
    weights = softmax(log_likelihoods)
    best = poses[0]
    found = []
    for pose, log, weight in zip(poses, log_likelihoods, weights, strict=True):
        if weight <= NEGLIGIBLE:
            continue
        for index, turn in enumerate(exact.turns):
            if pose is best and index == 0:
                continue
            name = SYMMETRY if pose is best else _name(best.R, pose.R, exact)
            found.append(Rival(name, pose_of(pose.R @ turn, pose.t), float(log - log_likelihoods[0])))
    return tuple(found)


def spread_of(best: Placed, poses: Sequence[Placed], weights: FloatArray, alike: Equivalence) -> FloatArray:
    """Return the weighted mean square of (dp, dtheta) from one pose to several, shape (6, 6), m, rad.

    Args:
        best: the one pose.
        poses: the others.
        weights: weights of the others, shape (N,).
        alike: symmetries of the target; of each pose the equivalent one nearest to the best counts.
    """
    middle = pose_of(best.R, best.t)
    others = [alike.nearest_pose(pose_of(pose.R, pose.t), middle) for pose in poses]
    turns = [(other.rotation * middle.rotation.inv()).as_rotvec() for other in others]
    steps = np.column_stack(([pose.t - best.t for pose in poses], turns))
    spread: FloatArray = np.einsum("n,ni,nj->ij", weights, steps, steps)
    return spread


def _name(best: FloatArray, other: FloatArray, exact: Equivalence) -> str:
    """Return the name of a rival: the angle between two attitudes, modulo the exact symmetries."""
    cosine = float(exact.cosines(best[None], other[None])[0, 0])
    return f"turned by {np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))):.0f} deg"


def belief_with_rivals(found: tuple[Rival, ...], belief: Belief, *, least: float) -> Belief:
    """Return the belief in a best pose that is not contradicted, with its rivals taken into account.

    Args:
        found: ``rivals`` of the best pose.
        belief: belief in the best pose alone.
        least: least weight at which the best pose is accepted; its exact symmetries count as the pose itself.
    """
    belief = replace(belief, needed_weight=least)
    logs = np.array([0.0, *(rival.log_likelihood for rival in found)])
    weights = softmax(logs)
    exact = [rival for rival in found if rival.exact]
    alike = 1 + len(exact)
    sure = alike * weights[0] >= least
    if sure and not exact:
        return replace(belief, rivals=found)
    if sure:
        reason = f"{alike} poses cannot be distinguished because of the target's symmetry"
        return replace(belief, level=BeliefLevel.DOUBTFUL, reason=reason, rivals=tuple(exact))
    first = next(rival for rival in found if not rival.exact)
    own = " with its symmetries" if exact else ""
    reason = (
        f"{len(found) + 1} poses explain the measurement: the best{own} has weight {alike * weights[0]:.2f} "
        f"({least:g} needed), the next is {first.name}"
    )
    return replace(belief, level=BeliefLevel.DOUBTFUL, reason=reason, rivals=found)


def with_one_noise(found: Sequence[Registration]) -> list[Registration]:
    """Return registrations of a frame with the largest noise that one of them shows, to be compared.

    The log likelihoods of N returns under two kinds of noise differ by a multiple of N at any pose.
    """
    noise_m = max((each.belief.larger_noise_m for each in found), default=0.0)
    return [
        replace(each, belief=replace(each.belief, evidence={**each.belief.evidence, NOISE_M: noise_m}))
        for each in found
    ]


def standing(found: Registration) -> tuple[bool, bool]:
    """Return the rank of a registration's belief; larger is better."""
    return found.belief.level is BeliefLevel.ACCEPTED, found.continues_track
