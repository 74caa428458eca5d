"""Methods for frames that show more than the target; other frames they pass on unchanged."""

from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from rpod_pose.belief import contradicted
from rpod_pose.ports import Acquirer, Acquisition, Methods, Outcome, Registration, Tracker
from rpod_pose.surroundings.separation import (
    Margin,
    RangeImage,
    Sight,
    around_place,
    places,
    with_target_at,
)
from rpod_schemas.types import Source
from rpod_target import Target

MARGINS = 0.2, 0.06, 0.015
"""Errors of a predicted pose, of the pose found from it, and of the one found from that, over the target's
radius. The last is needed only where other things touch the target."""
NARROW = 0.06
"""Least margin of ranges, over the target's radius."""
SIGMAS = 4.0
"""Least margin of ranges around a found pose, in their standard deviations."""
LEAST_VISIBLE = 0.2
"""Least share of the target that nothing may hide."""
MOST_CONTINUED = 0.5
"""Greatest share of the outline across which the surface goes on: more is a part of a larger thing."""


class Frames(Protocol):
    """Ranges of a sensor kind's frames, and frames without other things."""

    def image(self, frame: Any, *, fine: bool) -> RangeImage | None:
        """Return the ranges of a frame, of few rays or of as many as useful; None if they are not known."""
        ...

    def separated(self, frame: Any, labels: NDArray[np.uint8], inside: NDArray[np.bool_]) -> Any:
        """Return a frame in which each ray has become what its label says.

        Args:
            frame: the frame.
            labels: ``Label`` of each ray of its image, shape (rows, columns).
            inside: rays that must meet the target, same shape.
        """
        ...


def among_things(methods: Methods, frames: Frames, target: Target) -> Methods:
    """Return methods that find and track the target among other things."""
    scene = _Scene(frames, target)
    tracker = _Tracker(methods.tracker, scene)
    return Methods(_Acquirer(methods.acquirer, tracker, scene), tracker, methods.deskew)


@dataclass(frozen=True, eq=False)
class _Scene:
    frames: Frames
    target: Target

    def cluttered(self, frame: Any) -> RangeImage | None:
        """Return the ranges of a frame that shows more than the target; None for any other frame."""
        image = self.frames.image(frame, fine=False)
        return image if image is not None and image.shows_more_than(self.target.radius_m) else None


_NOTHING = Registration.none(Source.NONE, "nothing tracked yet")


class _Tracker:
    """Tracks in what a pose leaves of a frame: at first the predicted one, then the one that is found."""

    def __init__(self, tracker: Tracker[Any], scene: _Scene) -> None:
        self._tracker, self._scene = tracker, scene

    def track(self, measurement: Any, T_sensor_target: RigidTransform) -> Registration:
        image = self._scene.cluttered(measurement)
        if image is None:
            return self._tracker.track(measurement, T_sensor_target)
        return self.track_in(measurement, T_sensor_target)

    def track_in(self, measurement: Any, T_sensor_target: RigidTransform) -> Registration:
        """Return the registration in a frame that shows more than the target."""
        image = self._scene.frames.image(measurement, fine=True)
        assert image is not None  # noqa: S101 - known from the coarse image
        pose, found = T_sensor_target, _NOTHING
        for share in MARGINS:
            sight = with_target_at(image, self._scene.target, pose, self._margin(found, share))
            found = self._tracked(measurement, sight, pose)
            if found.T_sensor_target is None:
                break
            pose = found.T_sensor_target
            if share < MARGINS[0] and found.continues_track:
                break
        return _judged(found, sight)

    def _tracked(self, measurement: Any, sight: Sight, pose: RigidTransform) -> Registration:
        frame = self._scene.frames.separated(measurement, sight.labels, sight.inside)
        return self._tracker.track(frame, pose)

    def _margin(self, found: Registration, share: float) -> Margin:
        """Return the margin around a pose, given as a share of the target's radius."""
        place_m = share * self._scene.target.radius_m
        spread_m = SIGMAS * np.sqrt(found.cost_m2) if np.isfinite(found.cost_m2) else 0.0
        return Margin(place_m, max(place_m, NARROW * self._scene.target.radius_m, spread_m))


def _judged(found: Registration, sight: Sight) -> Registration:
    """Return a registration, which is contradicted where too little of the target is its own surface."""
    evidence = found.belief.evidence | {
        "visible_share": sight.visible_share,
        "continued_outline_share": sight.continued_share,
    }
    belief = replace(found.belief, evidence=evidence)
    if belief.continues_track and sight.visible_share < LEAST_VISIBLE:
        belief = contradicted(
            f"other things hide {1.0 - sight.visible_share:.0%} of the target, "
            f"{1.0 - LEAST_VISIBLE:.0%} at most",
            **evidence,
        )
    elif belief.continues_track and sight.continued_share > MOST_CONTINUED:
        belief = contradicted(
            f"the surface goes on across {sight.continued_share:.0%} of the target's outline: "
            "it is a part of something larger",
            **evidence,
        )
    return replace(found, belief=belief)


class _Acquirer:
    """Searches each surface of the target's size; the tracker verifies the pose in the whole frame."""

    def __init__(self, acquirer: Acquirer[Any], tracker: _Tracker, scene: _Scene) -> None:
        self._acquirer, self._tracker, self._scene = acquirer, tracker, scene

    def acquire(self, measurement: Any) -> Acquisition:
        image = self._scene.cluttered(measurement)
        if image is None:
            return self._acquirer.acquire(measurement)
        return self._found(measurement, image, None)

    def near(self, measurement: Any, T_sensor_target: RigidTransform) -> Acquisition:
        image = self._scene.cluttered(measurement)
        if image is None:
            return self._acquirer.near(measurement, T_sensor_target)
        return self._found(measurement, image, T_sensor_target)

    def _found(self, measurement: Any, image: RangeImage, pose: RigidTransform | None) -> Acquisition:
        radius_m, fine = self._scene.target.radius_m, self._scene.frames.image(measurement, fine=True)
        assert fine is not None  # noqa: S101 - known from the coarse image
        best: Acquisition | None = None
        for place in places(image, radius_m, None if pose is None else pose.translation):
            labels = around_place(image, fine, place, radius_m)
            frame = self._scene.frames.separated(measurement, labels, np.zeros(labels.shape, bool))
            found = self._acquirer.acquire(frame) if pose is None else self._acquirer.near(frame, pose)
            found = self._verified(measurement, found)
            if found.begins_track:
                return found
            if best is None or (best.outcome is Outcome.FAILED and found.outcome is not Outcome.FAILED):
                best = found
        nothing = "no surface of the target's size stands apart from other things"
        return best or Acquisition(Registration.none(Source.NONE, nothing))

    def _verified(self, measurement: Any, found: Acquisition) -> Acquisition:
        """Return an acquisition with the belief of the tracker in the whole frame."""
        if found.pose is None or not found.belief.continues_track:
            return found
        registration = self._tracker.track_in(measurement, found.pose)
        belief = registration.belief
        if belief.continues_track:
            belief = replace(found.belief, evidence=belief.evidence)
        return replace(found, registration=replace(registration, belief=belief))
