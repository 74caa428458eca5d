"""A tracker and a search for frames that show more than the target; other frames are passed on unchanged."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Generic

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from rpod_pose.belief import contradicted
from rpod_pose.ports import Acquirer, Acquisition, ComparingTracker, Outcome, Registration, Tracker
from rpod_pose.surroundings.contradicted import are_close, supported, with_contradiction
from rpod_pose.surroundings.frames import Frames, FrameT
from rpod_pose.surroundings.other_unit import nearer, other_units
from rpod_pose.surroundings.outline import seen_outline
from rpod_pose.surroundings.places import around_place, places
from rpod_pose.surroundings.separation import SIGMAS, Margin, RangeImage, Sight, with_target_at
from rpod_pose.unwanted import step
from rpod_schemas.arrays import FloatArray
from rpod_schemas.types import Source
from rpod_target import Target

MARGINS = 0.2, 0.06, 0.015
"""Errors of a predicted pose, of the pose found from it, and of the one found from that, over the target's
radius. The last is needed only where other things touch the target. Hand: wider ones keep more of what
touches the target, narrower ones cut off some of the target."""
NARROW = 0.06
"""Least margin of ranges, over the target's radius. Hand: the second of ``MARGINS``."""
BIAS_SIGMAS = 2.0
"""Error that all ranges of a frame share, in standard deviations, up to which a surface may be the target's
before a pose tells this error. Physics: one in 22 normal errors is larger."""
LEAST_VISIBLE = 0.2
"""Least share of the target that other things must leave visible. Hand: a track can go on with little;
``LEAST_VISIBLE_FIRST`` is the limit for its beginning."""
MOST_CONTINUED = 0.5
"""Greatest share of the outline across which the surface goes on. Hand: more is a part of a larger thing."""
DETAIL, LEAST_DETAIL = 0.06, 6
"""Size of a detail that must be explained, over the target's radius, and its least number of rays. Hand: a
smaller detail would be found in noise (decision 57)."""
LEAST_VISIBLE_FIRST = 0.75
"""Least share of the target that must be visible for a track to begin. Hand: details that are hidden do not
tell it from its near-symmetries."""
LEAST_IN_VIEW = 0.5
"""Least share of the target in the field of view for a track to begin. Hand: other things resemble a small
part."""
LEAST_OUTLINE = 0.5
"""Least share of the target's whole outline at which it is seen to end for a track to begin. Hand: an edge of
a wall or a plate has the shape of a target's side, but it does not go around a half of the target (decision
57)."""
RIVAL = 0.5
"""Least number of rays on another surface that is searched too, over that on the one with the target. Hand: a
smaller surface is a part of the first one's object."""
OUTLINE = "seen_outline_share"
"""Name of the evidence that says at how much of its outline the target is seen to end."""
MARGIN = "separation_margin"
"""Name of the evidence that says with which of the margins a pose was found."""
OTHER_UNIT = (
    "the pose is a part of a larger thing, which looks like the target itself if all depths are divided by "
    "{:g}: check the unit of the ranges, of a camera source.depth_unit_m"
)
"""Reason for which a part of a larger thing is not the target."""
VISIBLE = "visible_share"
"""Name of the evidence that a pose was verified in a whole frame."""


class TrackerAmongThings(Generic[FrameT]):
    """Tracks in the part of a frame that fits a pose: first the predicted pose, then the one that is found.

    Args:
        tracker: tracker of frames that show the target alone.
        frames: frames of the sensor kind.
        target: the target to track.
    """

    def __init__(self, tracker: Tracker[FrameT], frames: Frames[FrameT], target: Target) -> None:
        self._tracker, self.frames, self.target = tracker, frames, target

    def cluttered(self, frame: FrameT) -> RangeImage | None:
        """Return the ranges of few rays of a frame that shows more than the target; None for any other."""
        image = self.frames.image(frame, fine=False)
        if image is None or (image.hidden is None and not image.shows_more_than(self.target.radius_m)):
            return None
        return image

    def track(self, measurement: FrameT, T_sensor_target: RigidTransform) -> Registration:
        """Return the registration from a predicted pose, or the reason why the frame gives none."""
        whole = self.frames.whole_of(measurement)
        if whole is None and self.cluttered(measurement) is None:
            return self._tracker.track(measurement, T_sensor_target)
        if whole is not None and (reason := self.excluded(measurement, T_sensor_target)):
            belief = contradicted(reason)
            return Registration(Source.NONE, T_sensor_target=T_sensor_target, belief=belief)
        return self.track_among(measurement if whole is None else whole, T_sensor_target)

    def excluded(self, measurement: FrameT, T_sensor_target: RigidTransform) -> str:
        """Return why no pose near one that a search found can be the target's; empty if one may be.

        Only a part of a frame that keeps the whole one is asked. What the whole frame shows at the widest
        margin contradicts every pose within this margin, and takes much less time than an alignment.
        """
        whole = self.frames.whole_of(measurement)
        image = None if whole is None else self.frames.image(whole, fine=True)
        if image is None:
            return ""
        sight = self._sight(MARGINS[0], image, Registration.none(Source.NONE, ""), T_sensor_target)
        return _unlike(sight, self._most_unexplained(image, T_sensor_target))

    def log_likelihoods(
        self, measurement: FrameT, found: Sequence[Registration], *, ranked_only: bool = False
    ) -> FloatArray:
        """Return the log likelihoods of one frame at registered poses; 0 if the tracker compares none."""
        if not isinstance(self._tracker, ComparingTracker):
            return np.zeros(len(found))
        return self._tracker.log_likelihoods(measurement, found, ranked_only=ranked_only)

    def without_target_at(self, image: RangeImage, found: Registration) -> Sight:
        """Return what a found pose leaves of a frame, at the widest margin."""
        assert found.T_sensor_target is not None  # noqa: S101 - the caller's condition
        return self._sight(MARGINS[0], image, found, found.T_sensor_target)

    def _most_unexplained(self, image: RangeImage, T_sensor_target: RigidTransform) -> int:
        """Return the greatest number of connected rays that may remain unexplained."""
        distance_m = float(np.linalg.norm(T_sensor_target.translation))
        return max(LEAST_DETAIL, image.rays_across(DETAIL * self.target.radius_m, distance_m) ** 2)

    def again(self, measurement: FrameT, found: Registration) -> Registration:
        """Return a registration of the same frame from its own pose, with the margin that it was found at."""
        pose, whole = found.T_sensor_target, self.frames.whole_of(measurement)
        if pose is None or whole is None:
            return found if pose is None else self.track(measurement, pose)
        last = found.belief.evidence.get(MARGIN, MARGINS[-1])
        return self.track_among(whole, pose, margins=(last,), before=found)

    def track_among(
        self,
        measurement: FrameT,
        T_sensor_target: RigidTransform,
        *,
        margins: tuple[float, ...] = MARGINS,
        before: Registration | None = None,
    ) -> Registration:
        """Return the registration in a frame that shows more than the target.

        What the frame shows at a narrow margin may contradict every pose within it; this takes much less time
        than an alignment.

        Args:
            measurement: the whole frame.
            T_sensor_target: predicted pose.
            margins: errors of the pose that are tried in turn, over the target's radius.
            before: registration that gave the pose, if the same frame did.
        """
        step()
        image = self.frames.image(measurement, fine=True)
        assert image is not None  # noqa: S101 - the coarse image is known
        found, pose = before or Registration.none(Source.NONE, ""), T_sensor_target
        for share in margins:
            sight = self._sight(share, image, found, pose)
            if share < MARGINS[0] and _unlike(sight, self._most_unexplained(image, pose)):
                break
            found = self._tracked_in(sight, measurement, pose)
            if found.T_sensor_target is None or (share < MARGINS[0] and found.continues_track):
                break
            pose = found.T_sensor_target
        if found.T_sensor_target is None:
            return found
        belief = replace(found.belief, evidence={**found.belief.evidence, MARGIN: share})
        most_unexplained = self._most_unexplained(image, found.T_sensor_target)
        return _checked(replace(found, belief=belief), sight, most_unexplained)

    def _tracked_in(self, sight: Sight, measurement: FrameT, pose: RigidTransform) -> Registration:
        """Return the registration from a pose, T_sensor_target, in what a sight leaves of a whole frame."""
        return self._tracker.track(self.frames.separated(measurement, sight.labels, sight.inside), pose)

    def _sight(self, share: float, image: RangeImage, found: Registration, pose: RigidTransform) -> Sight:
        """Return what a pose says of each ray of a frame.

        Args:
            share: error of the pose, over the target's radius.
            image: ranges of many rays of the frame.
            found: registration of the same frame that gave the pose; one without a pose if none did.
            pose: T_sensor_target.
        """
        corrected = image.corrected(found.range_bias_m)
        return with_target_at(corrected, self.target, pose, self._margin(found, share))

    def _margin(self, found: Registration, share: float) -> Margin:
        """Return the margin around a pose, given as a share of the target's radius."""
        radius_m = self.target.radius_m
        known = np.isfinite(found.cost_m2)
        spread_m = SIGMAS * np.sqrt(found.cost_m2) if known else BIAS_SIGMAS * self.frames.range_bias_m
        return Margin(share * radius_m, float(max(share * radius_m, NARROW * radius_m, spread_m)))


def _unlike(sight: Sight, most_unexplained: int) -> str:
    """Return why a sight is not that of the target; empty if it may be."""
    if sight.visible_share < LEAST_VISIBLE:
        hidden = 1.0 - sight.visible_share
        return f"other things hide {hidden:.0%} of the target, {1.0 - LEAST_VISIBLE:.0%} at most"
    if sight.unexplained > most_unexplained:
        return f"a detail is not explained: {sight.unexplained} rays, {most_unexplained} at most"
    if sight.passed > most_unexplained:
        return f"rays pass through the target: {sight.passed} side by side, {most_unexplained} at most"
    return ""


def _checked(found: Registration, sight: Sight, most_unexplained: int) -> Registration:
    """Return a registration, which is contradicted where too little of it is the target's own surface."""
    evidence = {
        **found.belief.evidence,
        VISIBLE: sight.visible_share,
        "continued_outline_share": sight.continued_share,
    }
    reason = _unlike(sight, most_unexplained)
    if not reason and sight.continued_share > MOST_CONTINUED:
        share = f"{sight.continued_share:.0%} of the target's outline, {MOST_CONTINUED:.0%} at most"
        reason = f"the pose is a part of a larger thing: its surface goes on across {share}"
    if reason and found.continues_track:
        return replace(found, belief=contradicted(reason, **evidence))
    return replace(found, belief=replace(found.belief, evidence=evidence))


class AcquirerAmongThings(Generic[FrameT]):
    """Searches each surface of the target's size; the tracker verifies the pose in the whole frame.

    Args:
        acquirer: search in frames that show the target alone.
        tracker: tracker of frames that show other things too.
    """

    def __init__(self, acquirer: Acquirer[FrameT], tracker: TrackerAmongThings[FrameT]) -> None:
        self._acquirer, self._tracker = acquirer, tracker

    def acquire(self, measurement: FrameT) -> Acquisition:
        """Search without any prior pose."""
        image = self._tracker.cluttered(measurement)
        if image is None:
            return self._acquirer.acquire(measurement)
        return self._found(measurement, image, None)

    def near(self, measurement: FrameT, T_sensor_target: RigidTransform) -> Acquisition:
        """Search around a pose that is too far off for the tracker."""
        image = self._tracker.cluttered(measurement)
        if image is None:
            return self._acquirer.near(measurement, T_sensor_target)
        return self._found(measurement, image, T_sensor_target)

    def _found(self, measurement: FrameT, image: RangeImage, pose: RigidTransform | None) -> Acquisition:
        """Return the acquisition at the first place where a track may begin; at none, the best failure."""
        frames, radius_m = self._tracker.frames, self._tracker.target.radius_m
        fine = frames.image(measurement, fine=True)
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
        """Return the ratio of a unit in which a larger thing around a pose is the target; 0 if it is none."""
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
        fine = self._tracker.frames.image(measurement, fine=True)
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
        found = self._acquirer.acquire(part) if pose is None else self._acquirer.near(part, pose)
        return self._in_view(fine, self._verified(measurement, found))

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
            lambda one, other: are_close(self._tracker.target, one, other, MARGINS[0]),
            likely=likely,
        )
        return found if again is found else self._in_view(fine, again)

    def _searched_in_remainder(
        self, measurement: FrameT, fine: RangeImage, found: Acquisition, pose: RigidTransform | None
    ) -> Acquisition:
        """Return an accepted acquisition, or that of a search in what its pose leaves of the frame.

        In the first search, other things that touch the target count as its parts, so that it may miss the
        pose that explains the target best. The part of the frame that the accepted pose leaves shows little
        beside the target, and the same search compares all attitudes in it.
        """
        assert found.pose is not None  # noqa: S101 - it is accepted
        sight = self._tracker.without_target_at(fine, found.registration)
        again = self._searched(measurement, fine, sight.labels, pose)
        return found if again.outcome is Outcome.FAILED else again

    def _held(self, measurement: FrameT, found: Acquisition) -> Acquisition:
        """Return an acquisition, contradicted if the tracker loses an accepted pose in the same frame.

        It is aligned as the next frame will be; a pose at another thing is accepted from elsewhere only.
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
            f"needed, {visible:.0%} of it is not hidden, {LEAST_VISIBLE_FIRST:.0%} needed, and it is seen to "
            f"end at {outline:.0%} of its outline, {LEAST_OUTLINE:.0%} needed"
        )
        belief = replace(found.belief, insufficient=vague, evidence=evidence)
        return replace(found, registration=replace(found.registration, belief=belief))


def _apart_m(found: Acquisition, other: Acquisition | None) -> float:
    """Return the distance between the positions of two acquired poses; 0 without one."""
    if found.pose is None or other is None or other.pose is None:
        return 0.0
    return float(np.linalg.norm(found.pose.translation - other.pose.translation))
