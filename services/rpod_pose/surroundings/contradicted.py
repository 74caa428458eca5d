"""Poses that a part of a frame contradicts, where returns of other things in this part do so.

A search does not know which returns are the target's. Those of an arm or a stand contradict the right pose
too, and may make a near-symmetry likelier. A pose tells which returns cannot be the target's, so the search
is repeated without these. What remains compares all attitudes alike, since a return that no attitude explains
costs each the same. So the part ranks the poses, and the whole frame judges the best one.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from math import sqrt

import numpy as np
from scipy.spatial.transform import RigidTransform

from rpod_pose.belief import contradicted
from rpod_pose.ports import Acquisition, Outcome, Registration
from rpod_pose.registration.lie_group import PoseArrays
from rpod_pose.search.hypotheses import belief_with_rivals, rivals
from rpod_schemas.arrays import FloatArray
from rpod_schemas.poses import rotation_matrix
from rpod_schemas.types import BeliefLevel
from rpod_target import Equivalence, Target

ROUNDS = 3
"""Number of searches in what a contradicted pose leaves of a frame. Numerics: a budget; each starts from a
pose that fewer other things have led astray, and the last confirms the one before."""


def supported(
    found: Acquisition,
    track: Callable[[RigidTransform], Registration],
    search: Callable[[Registration], Acquisition],
    alike: Callable[[RigidTransform, RigidTransform], bool],
    *,
    likely: bool,
) -> Acquisition:
    """Return an acquisition that a part contradicts and the whole frame supports; others are unchanged.

    A pose counts if it is also the best one in what it leaves itself: what another pose leaves may lack
    returns of the target.

    Args:
        found: acquisition in a part of a frame.
        track: registration in the whole frame, from a pose.
        search: acquisition in what a pose leaves of the frame.
        alike: whether two poses leave about the same.
        likely: whether the target is probably in this part; elsewhere the frame must support the first pose.
    """
    again, left_by = found, None
    for number in range(ROUNDS + 1):
        if again.outcome is not Outcome.FAILED:
            return again
        if again.pose is None or not again.belief.ranked:
            break
        whole = track(again.pose)
        supports = whole.belief.level is BeliefLevel.ACCEPTED and whole.continues_track
        if supports and left_by is not None and alike(again.pose, left_by):
            return _in_whole_frame(again, whole) if _as_many(whole, found.registration) else found
        if number == ROUNDS or not (supports or likely):
            break
        left_by = whole.T_sensor_target if supports else None
        again = search(whole if supports else again.registration)
    return found


def are_close(target: Target, pose: RigidTransform, other: RigidTransform, share: float) -> bool:
    """Return whether two poses differ by less than a share of the radius, modulo exact symmetries."""
    R, R_other = rotation_matrix(pose), rotation_matrix(other)
    cosine = target.equivalence.cosines(R[None], R_other[None])[0, 0]
    turn_rad = float(np.arccos(np.clip(cosine, -1.0, 1.0)))
    apart_m = float(np.linalg.norm(pose.translation - other.translation))
    return apart_m < (share - turn_rad) * target.radius_m


def _as_many(whole: Registration, first: Registration) -> bool:
    """Return whether a pose explains as many measurements as the first one did, but for chance.

    A wrong pose may leave the target itself out of the remainder, and then be the best one there.
    """
    return whole.inliers >= first.inliers - sqrt(first.inliers)


def _in_whole_frame(found: Acquisition, whole: Registration) -> Acquisition:
    """Return an acquisition with the registration in the whole frame, and the rivals from the search."""
    ranked = found.belief
    belief = replace(whole.belief, insufficient=ranked.insufficient)
    belief = belief_with_rivals(ranked.rivals, belief, least=ranked.needed_weight)
    return replace(found, registration=replace(whole, belief=belief))


def with_likely(
    found: Acquisition, poses: Sequence[Registration], logs: FloatArray, exact: Equivalence
) -> Acquisition:
    """Return an acquisition with its near-symmetries as rivals; unchanged if all of these are unlikely.

    Args:
        found: accepted acquisition.
        poses: its registration, and those of its near-symmetries.
        logs: their log likelihoods in the same rays, shape (N,).
        exact: the target's exact symmetries.
    """
    order = np.argsort(-logs, kind="stable")
    ranked = [poses[index] for index in order]
    placed = [PoseArrays.of(each.T_sensor_target) for each in ranked if each.T_sensor_target is not None]
    others = rivals(placed, logs[order], exact)
    if order[0] == 0 and all(other.exact for other in others):
        return found
    belief = belief_with_rivals(others, ranked[0].belief, least=found.belief.needed_weight)
    return replace(found, registration=replace(ranked[0], belief=belief))


def with_contradiction(found: Acquisition, reason: str) -> Acquisition:
    """Return an acquisition whose pose is contradicted, with the evidence that it had."""
    belief = contradicted(reason, **found.belief.evidence)
    return replace(found, registration=replace(found.registration, belief=belief))
