"""Repeated searches for poses that are contradicted only by other things in a part of a frame.

A search does not know which returns are on the target. Those on an arm or a stand contradict the right pose
too, and may make a near-symmetry likelier. A pose determines which returns cannot be on the target, so the
search is repeated without them. The remaining returns compare all attitudes fairly, since a return that no
attitude explains adds the same to each. So the part of the frame ranks the poses, and the whole frame decides
about the best one.
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
"""Largest number of searches in the part of a frame that remains at a contradicted pose. Numerics: a budget;
each starts from a pose that is less affected by other things, and the last one confirms the previous one."""


def supported(
    found: Acquisition,
    track: Callable[[RigidTransform], Registration],
    search: Callable[[Registration], Acquisition],
    alike: Callable[[RigidTransform, RigidTransform], bool],
    *,
    likely: bool,
) -> Acquisition:
    """Return an acquisition that a part contradicts and the whole frame supports; others are unchanged.

    A pose is used only if it is also the best one in the part of the frame that remains at this pose: at
    another pose, returns of the target may be missing from the part.

    Args:
        found: acquisition in a part of a frame.
        track: registration in the whole frame, from a pose.
        search: acquisition in the part of the frame that remains at a pose.
        alike: whether two poses leave about the same part of a frame.
        likely: whether the target is probably in this part; if not, the frame must support the first pose.
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
    """Return whether a pose explains as many measurements as the first one, within chance.

    At a wrong pose the target itself may not be in the remaining part, and the pose may then be the best one
    there.
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
        poses: registration of the acquisition, and those of its near-symmetries.
        logs: their log likelihoods on the same rays, shape (N,).
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
    """Return an acquisition whose pose is contradicted for a reason; its evidence is kept."""
    belief = contradicted(reason, **found.belief.evidence)
    return replace(found, registration=replace(found.registration, belief=belief))
