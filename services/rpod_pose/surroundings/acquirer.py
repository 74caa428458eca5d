"""A search for frames that show more than the target, or a thing that touches it."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Generic

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_pose.ports import Acquirer, Acquisition, Likelihoods, Outcome, Registration
from rpod_pose.search.turns import Turns
from rpod_pose.surroundings.contradicted import are_close, supported, with_contradiction, with_likely
from rpod_pose.surroundings.frames import FrameT
from rpod_pose.surroundings.other_unit import nearer, other_units
from rpod_pose.surroundings.outline import seen_outline
from rpod_pose.surroundings.places import around_place, places
from rpod_pose.surroundings.separation import Label, RangeImage
from rpod_pose.surroundings.tracker import MARGINS, NARROW, RIVAL, VISIBLE, TrackerAmongThings
from rpod_schemas.poses import make_pose
from rpod_schemas.types import BeliefLevel, Source

LEAST_VISIBLE_FIRST = 0.75
"""Least share of the target that must be visible for a track to begin. Hand: hidden details cannot
distinguish it from its near-symmetries."""
LEAST_IN_VIEW = 0.5
"""Least share of the target in the field of view for a track to begin. Hand: other things resemble a small
part."""
LEAST_OUTLINE = 0.5
"""Least share of the target's outline that must be visible for a track to begin. Hand: an edge of a wall or a
plate has the shape of a target's side, but it does not go around half of the target (decision 57)."""
OUTLINE = "seen_outline_share"
"""Name of the evidence with the visible share of the target's outline."""
WITHIN_REACH = "; if something touches the target, declare it: see the bodies of a sensor's surroundings"
"""Remedy if a pose is found only without the things near the target: they look like details of the target."""
OTHER_UNIT = (
    "the pose is a part of a larger thing, which looks like the target itself if all depths are divided by "
    "{:g}: check the unit of the ranges, of a camera source.depth_unit_m"
)
"""Reason why a part of a larger thing is not the target."""


class AcquirerAmongThings(Generic[FrameT]):
    """Searches each surface of the target's size; the tracker verifies the pose in the whole frame.

    Args:
        acquirer: search in frames that show the target alone.
        tracker: tracker of frames that show other things too.
        likelihoods: compares poses in one frame; None if the search itself compares all of its poses in the
            whole frame.
    """

    def __init__(
        self,
        acquirer: Acquirer[FrameT],
        tracker: TrackerAmongThings[FrameT],
        likelihoods: Likelihoods | None = None,
    ) -> None:
        self._acquirer, self._tracker, self._likelihoods = acquirer, tracker, likelihoods
        self._turns = Turns.of(tracker.target)

    def acquire(self, measurement: FrameT) -> Acquisition:
        """Return the result of a search without a prior pose."""
        return self._acquired(measurement, None)

    def near(self, measurement: FrameT, T_sensor_target: RigidTransform) -> Acquisition:
        """Return the result of a search near a pose that is too far off for the tracker."""
        return self._acquired(measurement, T_sensor_target)

    def _acquired(self, measurement: FrameT, pose: RigidTransform | None) -> Acquisition:
        """Return the acquisition near a pose, or anywhere.

        A frame that shows little more than a target would fill is first assumed to show only the target. If
        it contradicts every pose, another thing may touch the target, for example an arm in front of a black
        curtain. A part of this thing must lie beyond the target's reach: what remains within the reach at a
        wrong pose may be a part of the target itself.
        """
        image = self._tracker.cluttered(measurement)
        if image is not None:
            return self._found(measurement, image, pose)
        alone = self._in_frame(measurement, pose)
        image = self._tracker.image(measurement, fine=False)
        contradicted = alone.outcome is Outcome.FAILED and alone.belief.level is BeliefLevel.CONTRADICTED
        if image is None or not contradicted:
            return alone
        among = self._found(measurement, image, pose)
        if among.outcome is Outcome.FAILED:
            return alone
        if self._tracker.is_touched(measurement, among.registration):
            return among
        belief = replace(alone.belief, reason=f"{alone.belief.reason}{WITHIN_REACH}")
        return replace(alone, registration=replace(alone.registration, belief=belief))

    def _in_frame(self, measurement: FrameT, pose: RigidTransform | None) -> Acquisition:
        """Return the acquisition of a target near a pose, or anywhere, in a frame that shows it alone."""
        if pose is None:
            return self._acquirer.acquire(measurement)
        return self._acquirer.near(measurement, pose)

    def _found(self, measurement: FrameT, image: RangeImage, pose: RigidTransform | None) -> Acquisition:
        """Return the acquisition at the first place where a track may begin; otherwise the best failure."""
        radius_m = self._tracker.target.radius_m
        fine = self._tracker.image(measurement, fine=True)
        assert fine is not None  # noqa: S101 - the coarse image is known
        nothing = "no surface of the target's size stands apart from other things"
        best = Acquisition(Registration.none(Source.NONE, nothing))
        accepted, taken, rays = None, np.zeros(image.range_m.shape, bool), 0
        for number, place in enumerate(places(image, radius_m, None if pose is None else pose.translation)):
            if accepted is not None and np.count_nonzero(place) < RIVAL * rays:
                break
            if accepted is not None and np.count_nonzero(place & taken) > RIVAL * np.count_nonzero(place):
                continue  # the same surface
            labels = around_place(image, fine, place, radius_m)
            found = self._searched(measurement, fine, labels, pose)
            found = self._supported(measurement, fine, found, pose, number == 0)
            if found.begins_track and accepted is None:
                found = self._searched_in_remainder(measurement, fine, found, pose)
                found = self._compared(measurement, fine, found)
            found = self._held(measurement, found)
            if found.begins_track and accepted is None:
                accepted, taken, rays = found, place, int(np.count_nonzero(place))
            elif found.begins_track and _apart_m(found, accepted) > radius_m:
                return with_contradiction(found, "two surfaces look like the target")
            if number == 0 or (best.outcome is Outcome.FAILED and found.outcome is not Outcome.FAILED):
                best = found
        if accepted is not None and (ratio := self._ratio_of_units(measurement, image, accepted)):
            return with_contradiction(accepted, OTHER_UNIT.format(ratio))
        return accepted or best

    def _ratio_of_units(self, measurement: FrameT, image: RangeImage, found: Acquisition) -> float:
        """Return the ratio of units with which a larger thing around a pose is the target; 0 if none fits."""
        frames, radius_m = self._tracker.frames, self._tracker.target.radius_m
        assert found.pose is not None  # noqa: S101 - it is accepted
        for ratio, thing in other_units(image, radius_m, found.pose.translation):
            scaled = frames.nearer(measurement, ratio)
            others = np.count_nonzero((image.range_m > 0.0) & ~thing)
            if others > np.count_nonzero(thing) and self._tracker.cluttered(scaled) is None:
                continue  # in this unit all of a room would be within the target's size
            if self._in_part(scaled, nearer(image, ratio), thing).outcome is not Outcome.FAILED:
                return ratio
        return 0.0

    def _in_part(self, measurement: FrameT, image: RangeImage, thing: NDArray[np.bool_]) -> Acquisition:
        """Return the acquisition of one thing in a frame, given by its rays, shape (rows, columns)."""
        target = self._tracker.target
        if self._tracker.cluttered(measurement) is None:
            return self._acquirer.acquire(measurement)
        fine = self._tracker.image(measurement, fine=True)
        assert fine is not None  # noqa: S101 - the coarse image is known
        labels = around_place(image, fine, thing, target.radius_m)
        return self._searched(measurement, fine, labels, None)

    def _searched(
        self, measurement: FrameT, fine: RangeImage, labels: NDArray[np.uint8], pose: RigidTransform | None
    ) -> Acquisition:
        """Return the acquisition in a part of a frame, verified in the whole frame.

        Args:
            measurement: the whole frame.
            fine: its ranges of many rays.
            labels: ``Label`` of each of these rays.
            pose: pose near which is searched; None for anywhere.
        """
        frames = self._tracker.frames
        part = frames.part_of(
            frames.separated(measurement, labels, np.zeros(labels.shape, bool)), measurement
        )
        return self._in_view(fine, self._verified(measurement, self._in_frame(part, pose)))

    def _supported(
        self,
        measurement: FrameT,
        fine: RangeImage,
        found: Acquisition,
        pose: RigidTransform | None,
        likely: bool,
    ) -> Acquisition:
        """Return ``supported`` of an acquisition in a part of a frame."""
        again = supported(
            found,
            lambda start: self._tracker.track_among(measurement, start),
            lambda left: self._searched(
                measurement, fine, self._tracker.without_target_at(fine, left).labels, pose
            ),
            self._are_close,
            likely=likely,
        )
        return found if again is found else self._in_view(fine, again)

    def _are_close(self, pose: RigidTransform, other: RigidTransform) -> bool:
        """Return whether two poses are so close that they leave about the same part of a frame."""
        return are_close(self._tracker.target, pose, other, MARGINS[0])

    def _is_among(self, found: Registration, others: Sequence[Registration]) -> bool:
        """Return whether a registered pose is close to one of several others."""
        poses = (found.T_sensor_target, *(other.T_sensor_target for other in others))
        first, *rest = (pose for pose in poses if pose is not None)
        return any(self._are_close(first, other) for other in rest)

    def _searched_in_remainder(
        self, measurement: FrameT, fine: RangeImage, found: Acquisition, pose: RigidTransform | None
    ) -> Acquisition:
        """Return an accepted acquisition, or that of a second search in the part of the frame at its pose.

        In the first search, other things that touch the target count as its parts, so that it may miss the
        best pose. The part of the frame that remains at the accepted pose shows little besides the target. In
        this part all attitudes are compared again.
        """
        assert found.pose is not None  # noqa: S101 - it is accepted
        sight = self._tracker.without_target_at(fine, found.registration)
        again = self._searched(measurement, fine, sight.labels, pose)
        return found if again.outcome is Outcome.FAILED else again

    def _compared(self, measurement: FrameT, fine: RangeImage, found: Acquisition) -> Acquisition:
        """Return an accepted acquisition, or that of a near-symmetry that is likelier in the whole frame.

        A search in a part of the frame also compares poses with other things in this part, which may make a
        near-symmetry likelier. Here each pose is aligned in the part of the frame that remains at this pose.
        Then all poses are compared on all rays that remain at one of them.
        """
        pose, tracker = found.pose, self._tracker
        if self._likelihoods is None or pose is None or not found.begins_track:
            return found
        starts = (
            make_pose(rotation=pose.rotation * Rotation.from_matrix(turn), translation_m=pose.translation)
            for turn in self._turns.all[: self._turns.declared]
        )
        poses = [found.registration]
        for start in starts:
            turned = tracker.track_among(measurement, start)
            if turned.continues_track and not self._is_among(turned, poses):
                poses.append(turned)
        sights = [tracker.near_target_at(fine, each) for each in poses]
        kept = np.any([sight.labels == Label.KEPT for sight in sights], axis=0)
        labels = np.where(kept, np.uint8(Label.KEPT), sights[0].labels)
        part = tracker.frames.separated(measurement, labels, np.zeros(labels.shape, bool))
        again = with_likely(found, poses, self._likelihoods(part, poses), self._turns.exact)
        return found if again is found else self._in_view(fine, again)

    def _held(self, measurement: FrameT, found: Acquisition) -> Acquisition:
        """Return an acquisition, contradicted if the tracker refuses its pose in the same frame.

        The tracker starts from the pose, as in the next frame. A pose at another thing may be accepted when
        it is reached from elsewhere, but not from itself.
        """
        if found.pose is None or not found.begins_track:
            return found
        again = self._tracker.track_among(measurement, found.pose)
        return found if again.continues_track else with_contradiction(found, again.belief.reason)

    def _verified(self, measurement: FrameT, found: Acquisition) -> Acquisition:
        """Return an acquisition with the tracker's belief in the whole frame, if that is not known yet."""
        if found.pose is None or not found.belief.continues_track or VISIBLE in found.belief.evidence:
            return found
        registration = self._tracker.track_among(measurement, found.pose)
        belief = registration.belief
        if belief.continues_track:
            belief = replace(found.belief, evidence=belief.evidence)
        return replace(found, registration=replace(registration, belief=belief))

    def _in_view(self, image: RangeImage, found: Acquisition) -> Acquisition:
        """Return an acquisition whose belief says whether enough of the target is in the field of view."""
        if found.pose is None or not found.begins_track:
            return found
        target = self._tracker.target
        share = image.in_view(found.pose.apply(target.model_points_m))
        visible = found.belief.evidence.get(VISIBLE, 1.0)
        corrected = image.corrected(found.registration.range_bias_m)
        outline = seen_outline(corrected, target, found.pose, NARROW * target.radius_m)
        evidence = {**found.belief.evidence, OUTLINE: outline}
        if share >= LEAST_IN_VIEW and visible >= LEAST_VISIBLE_FIRST and outline >= LEAST_OUTLINE:
            belief = replace(found.belief, evidence=evidence)
            return replace(found, registration=replace(found.registration, belief=belief))
        vague = (
            f"the frame shows other things too: {share:.0%} of the target is in view, {LEAST_IN_VIEW:.0%} "
            f"needed, {visible:.0%} of it is not hidden, {LEAST_VISIBLE_FIRST:.0%} needed, and "
            f"{outline:.0%} of its outline is visible, {LEAST_OUTLINE:.0%} needed"
        )
        belief = replace(found.belief, insufficient=vague, evidence=evidence)
        return replace(found, registration=replace(found.registration, belief=belief))


def _apart_m(found: Acquisition, other: Acquisition | None) -> float:
    """Return the distance between the positions of two acquired poses, m; 0 if one of them is missing."""
    if found.pose is None or other is None or other.pose is None:
        return 0.0
    return float(np.linalg.norm(found.pose.translation - other.pose.translation))
