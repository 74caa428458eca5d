"""Poses that a part of a frame contradicts, where returns of other things in this part do so.

A search does not know which returns are the target's. Those of an arm or a stand contradict the right pose
too, and may make a near-symmetry likelier. A pose tells which returns cannot be the target's, so the search
is repeated without these. What remains compares all attitudes alike, since a return that no attitude explains
costs each the same. So the part ranks the poses, and the whole frame judges the best one.
"""

from collections.abc import Callable
from dataclasses import replace
from math import sqrt

from scipy.spatial.transform import RigidTransform

from rpod_pose.ports import Acquisition, Outcome, Registration
from rpod_pose.search.hypotheses import belief_with_rivals
from rpod_schemas.types import BeliefLevel

ROUNDS = 2
"""Number of searches in what a contradicted pose leaves of a frame. Numerics: a budget; the second starts
from a pose that fewer other things have led astray."""


def supported(
    found: Acquisition,
    track: Callable[[RigidTransform], Registration],
    search: Callable[[Registration], Acquisition],
    *,
    likely: bool,
) -> Acquisition:
    """Return an acquisition that a part contradicts and the whole frame supports; others are unchanged.

    Args:
        found: acquisition in a part of a frame.
        track: registration in the whole frame, from a pose.
        search: acquisition in what a pose leaves of the frame.
        likely: whether the target is probably in this part; elsewhere the frame must support the first pose.
    """
    again = found
    for number in range(ROUNDS + 1):
        if again.outcome is not Outcome.FAILED:
            return again
        if again.pose is None or not again.belief.ranked:
            break
        whole = track(again.pose)
        supports = whole.belief.level is BeliefLevel.ACCEPTED and whole.continues_track
        if supports and number:
            return _judged(again, whole) if _as_many(whole, found.registration) else found
        if number == ROUNDS or not (supports or likely):
            break
        again = search(whole if supports else again.registration)
    return found


def _as_many(whole: Registration, first: Registration) -> bool:
    """Return whether a pose explains as many measurements as the first one did, but for chance.

    A wrong pose may leave the target itself out of the remainder, and then be the best one there.
    """
    return whole.inliers >= first.inliers - sqrt(first.inliers)


def _judged(found: Acquisition, whole: Registration) -> Acquisition:
    """Return an acquisition with the registration in the whole frame, and the rivals from the search."""
    ranked = found.belief
    belief = replace(whole.belief, insufficient=ranked.insufficient)
    belief = belief_with_rivals(ranked.rivals, belief, least=ranked.needed_weight)
    return replace(found, registration=replace(whole, belief=belief))
