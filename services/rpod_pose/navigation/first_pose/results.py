"""Consequences of a search's result: a track begins, or the parallel tracks of rivals, or none."""

from collections.abc import Callable, Mapping
from dataclasses import replace

from rpod_pose.measurement import Measurement
from rpod_pose.navigation.first_pose.beginning import Beginning
from rpod_pose.navigation.first_pose.searches import PAUSED, Found, Search
from rpod_pose.navigation.frames import as_measured
from rpod_pose.navigation.parallel import ParallelTracks
from rpod_pose.navigation.pose_measurement import PoseMeasurement
from rpod_pose.navigation.rivals import Rivals
from rpod_pose.navigation.sensors.ranges import Ranges
from rpod_pose.navigation.sensors.streams import searched
from rpod_pose.navigation.state import Cause, NavigatorState, Output
from rpod_pose.ports import Methods, Registration
from rpod_schemas.config.estimator import EstimatorSettings
from rpod_target import Equivalence


class SearchResults:
    """Applies the results of searches while there is no track.

    Args:
        settings: settings of the estimator.
        methods: methods of each sensor, by its name.
        beginning: begins tracks.
        parallel: starts and continues the tracks of rivals.
        output: composes the output of a frame.
        alike: which attitudes of the target no measurement distinguishes.
    """

    def __init__(
        self,
        settings: EstimatorSettings,
        methods: Mapping[str, Methods],
        *,
        beginning: Beginning,
        parallel: ParallelTracks,
        output: Callable[..., Output],
        alike: Equivalence,
    ) -> None:
        self._tuning, self._methods = settings.navigator.tuning, methods
        self._ranges = Ranges(settings.sensors)
        self._beginning, self._parallel = beginning, parallel
        self._output, self._alike = output, alike

    def first(self, state: NavigatorState, search: Search, found: Found) -> tuple[NavigatorState, Output]:
        """Begin a track, or the tracks of rivals, if a search has found the target."""
        event, acquisition = search.event, found.acquisition
        registration, belief = acquisition.registration, acquisition.belief
        if found.nearby and not acquisition.begins_track:
            return state, self._output(state, event, reason=search.reason)
        if found.paused:
            return state, replace(self._output(state, event, search=PAUSED), paused=True)
        if not found.nearby:
            state = replace(state, streams=searched(state.streams, event.sensor, event.stamp_ns))
        if why := self._ranges.not_of(event.sensor, registration):
            return state, self._output(state, event, reason=why, cause=Cause.OUT_OF_RANGE)
        if acquisition.begins_track:
            before, event = _frames_of(search, found)
            state = self._beginning.at_found(state, event, registration, before)
            return state, self._output(state, event, registration)
        if self._methods[event.sensor].likelihoods is not None:
            tracks = self._parallel.started(event, acquisition, state.before_loss)
            if 1 < len(tracks) <= self._tuning.most_rivals:
                since_ns = event.stamp_ns
                rivals = Rivals(tracks, event.sensor, since_ns, since_ns, belief.needed_weight)
                state = replace(state, rivals=rivals, searches={})
        return state, self._output(state, event, registration, reason=belief.refusal, found=acquisition)

    def again(
        self, state: NavigatorState, rivals: Rivals, search: Search, found: Found
    ) -> tuple[NavigatorState, Output]:
        """Begin a track at the best rival, if it is probable enough also among the poses of a new search."""
        event, registration = search.event, search.registration
        others = self._parallel.also_found(rivals, event, found.acquisition, state.before_loss)
        joined = rivals.joined_by(others, self._alike) if others else rivals
        if others and joined.decided and registration is not None:
            state = self._beginning.at_remaining(state, joined, event)
            return state, self._output(state, event, registration)
        return self.keep_rivals(state, joined, event, registration)

    def keep_rivals(
        self, state: NavigatorState, rivals: Rivals, event: Measurement, registration: Registration | None
    ) -> tuple[NavigatorState, Output]:
        """Keep the rivals for the next frame, unless they are too many."""
        if len(rivals.tracks) <= self._tuning.most_rivals:
            state = replace(state, rivals=rivals)
        else:
            state = replace(state, rivals=None, searches={})
        return state, self._output(state, event, registration, reason=rivals.reason(self._alike))


def _frames_of(search: Search, found: Found) -> tuple[PoseMeasurement | None, Measurement]:
    """Return the pose before that of a result, if one was followed, and the frame of the result."""
    if not found.track:
        return None, search.event
    (stamp_ns, registration), last = found.track
    first, *_ = search.frames_from(stamp_ns)
    event, *_ = search.frames_from(last.stamp_ns)
    return as_measured(registration, first), event
