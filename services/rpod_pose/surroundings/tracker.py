"""A tracker for frames that show more than the target, or a thing that touches it."""

from collections.abc import Sequence
from dataclasses import replace
from math import prod
from typing import Generic

import numpy as np
from scipy.spatial.transform import RigidTransform

from rpod_pose.belief import contradicted, doubtful
from rpod_pose.cancellation import stop_if_cancelled
from rpod_pose.ports import ClimbingTracker, ComparingTracker, Registration, Tracker
from rpod_pose.surroundings.frames import Frames, FrameT
from rpod_pose.surroundings.separation import RangeImage
from rpod_pose.surroundings.sight import SIGMAS, Margin, Sight, with_target_at
from rpod_schemas.arrays import FloatArray
from rpod_schemas.types import BeliefLevel, Source
from rpod_target import Target

MARGINS = 0.2, 0.06, 0.015
"""Largest errors of a predicted pose, of the pose found from it, and of the pose found from the second one,
over the target's radius. The third is needed only if other things touch the target. Hand: wider ones keep
more of the things that touch the target, narrower ones remove parts of the target."""
NARROW = 0.06
"""Least margin of ranges, over the target's radius. Hand: the second of ``MARGINS``."""
BIAS_SIGMAS = 2.0
"""Largest tolerated error that all ranges of a frame share, in standard deviations, while no pose determines
this error. Physics: one in 22 normal errors is larger."""
RIVAL = 0.5
"""Least number of rays on the smaller of two surfaces that both count, over the number on the larger one.
Hand: a smaller surface is a part of the same object."""
LEAST_VISIBLE = 0.2
"""Least share of the target that must be visible in a track. Hand: a track can continue with little;
``LEAST_VISIBLE_FIRST`` is the limit for its beginning."""
MOST_CONTINUED = 0.5
"""Largest share of the outline across which the surface continues. Hand: with more, the pose is on a part of
a larger thing."""
DETAIL, LEAST_DETAIL = 0.06, 6
"""Size of a detail that must be explained, over the target's radius, and its least number of rays. Hand:
smaller details would be found in noise (decision 57)."""
MARGIN = "separation_margin"
"""Name of the evidence with the margin at which a pose was found."""
VISIBLE = "visible_share"
"""Name of the evidence with the visible share of the target; its presence shows that a pose was verified in a
whole frame."""
MEASURED = "measured_share"
"""Name of the evidence with the share of the frame's ranges that are on the target."""


class TrackerAmongThings(Generic[FrameT]):
    """Tracks in the part of a frame that fits a pose: first the predicted pose, then the measured one.

    Args:
        tracker: tracker of frames that show the target alone.
        frames: frames of the sensor kind.
        target: the target to track.
        touching: whether a thing may touch the target in a frame that shows little more than the target. If
            such a frame contradicts the pose and shows something beyond the target's reach, it is treated as
            one that shows other things. A search does this itself, once for all its poses.
    """

    def __init__(
        self, tracker: Tracker[FrameT], frames: Frames[FrameT], target: Target, *, touching: bool = False
    ) -> None:
        self._tracker, self.frames, self.target = tracker, frames, target
        self._touching = touching
        self._images: dict[bool, tuple[FrameT, RangeImage | None]] = {}

    def image(self, frame: FrameT, *, fine: bool) -> RangeImage | None:
        """Return ``Frames.image``; that of the last frame is kept, since each pose of a search needs it."""
        last = self._images.get(fine)
        if last is None or last[0] is not frame:
            last = self._images[fine] = frame, self.frames.image(frame, fine=fine)
        return last[1]

    def cluttered(self, frame: FrameT) -> RangeImage | None:
        """Return the ranges of few rays if a frame shows more than the target; otherwise None."""
        image = self.image(frame, fine=False)
        if image is None or (image.hidden is None and not image.shows_more_than(self.target.radius_m)):
            return None
        return image

    def track(self, measurement: FrameT, T_sensor_target: RigidTransform) -> Registration:
        """Return the registration from a predicted pose, or the reason why the frame gives none."""
        whole = self.frames.whole_of(measurement)
        if whole is None:
            if self.cluttered(measurement) is None:
                return self._alone(measurement, T_sensor_target)
            return self.track_among(measurement, T_sensor_target)
        sight = self._first_sight(whole, T_sensor_target)
        if sight is not None and (reason := self._unlike(sight, whole, T_sensor_target)):
            belief = contradicted(reason)
            return Registration(Source.NONE, T_sensor_target=T_sensor_target, belief=belief)
        return self.track_among(whole, T_sensor_target, first=sight)

    def _alone(self, measurement: FrameT, T_sensor_target: RigidTransform) -> Registration:
        """Return the registration in a frame that shows little more than the target would fill."""
        alone = self._tracker.track(measurement, T_sensor_target)
        if alone.continues_track or not self._touching:
            return alone
        if self.image(measurement, fine=False) is None:
            return alone
        among = self.track_among(measurement, T_sensor_target)
        return among if among.continues_track and self.is_touched(measurement, among) else alone

    def is_touched(self, measurement: FrameT, found: Registration) -> bool:
        """Return whether a frame shows another thing beyond the target's reach at a measured pose.

        The pose must explain more than a small part of the frame. Otherwise the other thing would be the
        target itself, and the pose would be in a hole of it or on one of its details.
        """
        image, pose = self.image(measurement, fine=True), found.T_sensor_target
        measured = found.belief.evidence.get(MEASURED, 0.0)
        if image is None or pose is None or measured < RIVAL * (1.0 - measured):
            return False
        return image.rays_beyond((1.0 + NARROW) * self.target.radius_m, pose) >= LEAST_DETAIL

    def excluded(self, measurement: FrameT, T_sensor_target: RigidTransform) -> str:
        """Return why no pose near one of a search can be that of the target; empty if one can be.

        This is checked only in a part of a frame that contains the whole one. A contradiction in the whole
        frame at the widest margin holds for every pose within this margin. The check takes much less time
        than an alignment.
        """
        whole = self.frames.whole_of(measurement)
        sight = None if whole is None else self._first_sight(whole, T_sensor_target)
        if whole is None or sight is None:
            return ""
        return self._unlike(sight, whole, T_sensor_target)

    def _first_sight(self, frame: FrameT, T_sensor_target: RigidTransform) -> Sight | None:
        """Return the classes of a frame's rays at a predicted pose; None if the frame has no ranges."""
        image = self.image(frame, fine=True)
        if image is None:
            return None
        return self._sight(MARGINS[0], image, Registration.none(Source.NONE, ""), T_sensor_target)

    def _unlike(self, sight: Sight, frame: FrameT, T_sensor_target: RigidTransform) -> str:
        """Return why the rays of a frame cannot show the target at a pose; empty if they can."""
        image = self.image(frame, fine=True)
        assert image is not None  # noqa: S101 - it has a sight
        return _unlike(sight, self._most_unexplained(image, T_sensor_target))

    def log_likelihoods(
        self, measurement: FrameT, found: Sequence[Registration], *, ranked_only: bool = False
    ) -> FloatArray:
        """Return the log likelihoods of one frame at registered poses; 0 if the tracker compares none."""
        if not isinstance(self._tracker, ComparingTracker):
            return np.zeros(len(found))
        return self._tracker.log_likelihoods(measurement, found, ranked_only=ranked_only)

    def climbed(self, measurement: FrameT, found: Registration) -> Registration:
        """Return a coarse registration at the likeliest pose nearby, if nothing else is in the frame."""
        if not isinstance(self._tracker, ClimbingTracker) or MARGIN in found.belief.evidence:
            return found
        return self._tracker.climbed(measurement, found)

    def without_target_at(self, image: RangeImage, found: Registration) -> Sight:
        """Return the classes of a frame's rays at a measured pose, with the widest margin."""
        assert found.T_sensor_target is not None  # noqa: S101 - the caller's condition
        return self._sight(MARGINS[0], image, found, found.T_sensor_target)

    def near_target_at(self, image: RangeImage, found: Registration) -> Sight:
        """Return the classes of a frame's rays at a measured pose, with the narrow margin."""
        assert found.T_sensor_target is not None  # noqa: S101 - the caller's condition
        return self._sight(NARROW, image, found, found.T_sensor_target)

    def _most_unexplained(self, image: RangeImage, T_sensor_target: RigidTransform) -> int:
        """Return the largest number of connected rays that may remain unexplained."""
        distance_m = float(np.linalg.norm(T_sensor_target.translation))
        return max(LEAST_DETAIL, prod(image.rays_across(DETAIL * self.target.radius_m, distance_m)))

    def again(self, measurement: FrameT, found: Registration) -> Registration:
        """Return the frame's registration, started from an earlier one's pose and with its margin."""
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
        first: Sight | None = None,
    ) -> Registration:
        """Return the registration in a frame that shows more than the target.

        First the frame is checked at each margin: a contradiction holds for every pose within the margin, and
        the check takes much less time than an alignment.

        Args:
            measurement: the whole frame.
            T_sensor_target: predicted pose.
            margins: errors of the pose that are tried in turn, over the target's radius.
            before: registration of the same frame that gave the pose; None if there is none.
            first: classes of the rays at the predicted pose with the first margin; None if they are unknown.
        """
        stop_if_cancelled()
        image = self.image(measurement, fine=True)
        assert image is not None  # noqa: S101 - the coarse image is known
        found, pose = before or Registration.none(Source.NONE, ""), T_sensor_target
        for share in margins:
            sight, first = first or self._sight(share, image, found, pose), None
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
        """Return the registration from a pose, T_sensor_target, in the rays that a sight keeps of a frame."""
        return self._tracker.track(self.frames.separated(measurement, sight.labels, sight.inside), pose)

    def _sight(self, share: float, image: RangeImage, found: Registration, pose: RigidTransform) -> Sight:
        """Return the classes of a frame's rays at a pose.

        Args:
            share: error of the pose, over the target's radius.
            image: ranges of many rays of the frame.
            found: registration of the same frame that gave the pose; one without a pose if none did.
            pose: T_sensor_target.
        """
        corrected = image.corrected(found.range_bias_m)
        return with_target_at(corrected, self.target, pose, self._margin(found, share))

    def _margin(self, found: Registration, share: float) -> Margin:
        """Return the margin of a pose from a share of the target's radius."""
        radius_m = self.target.radius_m
        known = np.isfinite(found.cost_m2)
        spread_m = SIGMAS * np.sqrt(found.cost_m2) if known else BIAS_SIGMAS * self.frames.range_bias_m
        return Margin(share * radius_m, float(max(share * radius_m, NARROW * radius_m, spread_m)))


def _unlike(sight: Sight, most_unexplained: int) -> str:
    """Return why the rays cannot show the target at the pose; empty if they can."""
    if sight.visible_share < LEAST_VISIBLE:
        hidden = 1.0 - sight.visible_share
        return f"other things hide {hidden:.0%} of the target, limit {1.0 - LEAST_VISIBLE:.0%}"
    if sight.measured < most_unexplained:
        return f"the ranges do not show the target: {sight.measured} are on it, {most_unexplained} needed"
    if sight.unexplained > most_unexplained:
        return f"a detail is not explained: {sight.unexplained} connected rays, limit {most_unexplained}"
    if sight.passed > most_unexplained:
        return f"rays pass through the target: {sight.passed} connected rays, limit {most_unexplained}"
    return ""


def _checked(found: Registration, sight: Sight, most_unexplained: int) -> Registration:
    """Return a registration that is contradicted if the frame cannot show the target at its pose."""
    evidence = {
        **found.belief.evidence,
        VISIBLE: sight.visible_share,
        MEASURED: sight.measured_share,
        "continued_outline_share": sight.continued_share,
    }
    reason = _unlike(sight, most_unexplained)
    if not reason and sight.continued_share > MOST_CONTINUED:
        share = f"{sight.continued_share:.0%} of the target's outline, limit {MOST_CONTINUED:.0%}"
        reason = f"the pose is on a part of a larger thing: its surface continues across {share}"
    if reason and found.continues_track:
        return replace(found, belief=contradicted(reason, **evidence))
    if found.belief.level is BeliefLevel.ACCEPTED and (reason := _by_edges_of_others(found, sight)):
        return replace(found, belief=replace(doubtful(reason, **evidence), insufficient=reason))
    return replace(found, belief=replace(found.belief, evidence=evidence))


def _by_edges_of_others(found: Registration, sight: Sight) -> str:
    """Return why the ranges do not support a pose that the amplitude alone measures; empty if they do.

    Among other things some edges are near their place by chance. Where most ranges within the target's
    outline are on other things, these edges may be theirs.
    """
    if found.source is not Source.PMD_AMPLITUDE or sight.elsewhere <= sight.measured:
        return ""
    return (
        f"the amplitude alone measures the pose, and of the ranges within its outline "
        f"{sight.elsewhere} are on other things, {sight.measured} on the target"
    )
