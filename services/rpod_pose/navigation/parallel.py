"""Parallel tracks of the rivals of a first pose, continued frame by frame."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from rpod_pose.measurement import Measurement
from rpod_pose.navigation.filter import FilterState, predict
from rpod_pose.navigation.first_pose.beginning import Beginning
from rpod_pose.navigation.first_pose.searches import expecting
from rpod_pose.navigation.frames import as_measured, as_of_stamp
from rpod_pose.navigation.history import History, apply
from rpod_pose.navigation.rivals import Rival, Rivals, distinct
from rpod_pose.ports import Acquisition, Methods, Registration
from rpod_pose.search.hypotheses import with_one_noise
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.estimator.filter import FilterConfig
from rpod_schemas.poses import chained
from rpod_schemas.types import SensorFrame
from rpod_target import Equivalence


class Tracked(NamedTuple):
    """Rivals after a frame, and the registration of the best of them."""

    rivals: Rivals
    registration: Registration


class ParallelTracks:
    """Starts and continues the tracks of rivals.

    Args:
        beginning: starts filters at measured poses, and the tracks of the target's joints.
        config: configuration of the filter.
        alike: which attitudes no measurement distinguishes.
    """

    def __init__(self, beginning: Beginning, config: FilterConfig, alike: Equivalence) -> None:
        self._beginning = beginning
        self._config = config
        self._alike = alike

    def started(
        self, event: Measurement, found: Acquisition, past: FilterState | None = None
    ) -> tuple[Rival, ...]:
        """Return a rival for each pose that explains a frame, best first; empty if none does.

        ``past`` is the filter of the track before them, if there was one that stays of use.
        """
        if found.pose is None:
            return ()
        measured = as_measured(found.registration, event)
        angles = (found.registration.angles, *(rival.angles for rival in found.belief.rivals))
        rivals = []
        for each, there in zip(found.hypotheses, angles, strict=False):  # no hypotheses if the search failed
            pose = chained(event.T_chaser_sensor, each.pose)
            filtered = self._beginning.filter_at(replace(measured, T_chaser_target=pose), past)
            joints = self._beginning.joints_after({}, there or found.registration.angles, event.stamp_ns)
            rivals.append(Rival(History(filtered), each.log_likelihood, joints))
        return distinct(rivals, self._alike)

    def continued(self, rivals: Rivals, event: Measurement, methods: Methods) -> Tracked | None:
        """Return the rivals that a frame does not exclude, with new weights; None if it excludes all."""
        left, seen = [], []
        for rival in rivals.tracks:
            predicted = rival.history.at(event.stamp_ns, self._config)
            if predicted is None:
                continue
            frame = as_of_stamp(event, predicted, methods.deskew)
            prediction = chained(event.T_chaser_sensor.inv(), predicted.T_chaser_target)
            expected = {name: track.at(event.stamp_ns).angle for name, track in rival.joints.items()}
            registration = expecting(methods, expected).tracker.track(frame, prediction)
            if registration.T_sensor_target is None or not registration.continues_track:
                continue
            since_s = rival.history.since_s(event.stamp_ns, event.sensor)
            measured = replace(as_measured(registration, event), since_s=since_s)
            applied = apply(rival.history, measured, self._config, predicted)
            if applied.accepted:
                joints = self._beginning.joints_after(rival.joints, registration.angles, event.stamp_ns)
                left.append(replace(rival, history=applied.history, joints=joints))
                seen.append((frame, registration))
        if not left:
            return None
        share = rivals.share_of_frame(event.stamp_ns, self._config.inflation())
        logs = share * _likelihoods(methods, *zip(*seen, strict=True))
        weighed = [
            replace(rival, log_evidence=rival.log_evidence + log)
            for rival, log in zip(left, logs.tolist(), strict=True)
        ]
        tracks = distinct(weighed, self._alike)
        of_best = next(i for i, rival in enumerate(weighed) if rival is tracks[0])
        return Tracked(
            rivals._replace(
                tracks=tracks, newest_ns=max(rivals.newest_ns, event.stamp_ns), frames=rivals.frames + 1
            ),
            seen[of_best][1],
        )

    def also_found(
        self, rivals: Rivals, event: Measurement, found: Acquisition, past: FilterState | None = None
    ) -> tuple[Rival, ...]:
        """Return the poses that a search has found while rivals are tracked, at the rivals' newest stamp.

        The first search may have missed the right pose, or its track may have been lost since. If the rivals
        are newer than the searched frame, the poses are predicted to them with the twist of the best rival.
        """
        best = rivals.tracks[0].state
        others = self.started(event, found, past)
        if best.stamp_ns <= event.stamp_ns:
            return others
        return tuple(
            replace(
                other, history=History(predict(_moving_as(best, other.state), best.stamp_ns, self._config))
            )
            for other in others
        )


def _moving_as(best: FilterState, other: FilterState) -> FilterState:
    return replace(other, velocity_m_s=best.velocity_m_s, rate_rad_s=best.rate_rad_s)


def _likelihoods(
    methods: Methods, frames: Sequence[SensorFrame], found: Sequence[Registration]
) -> FloatArray:
    """Return the log likelihoods at poses, shape (N,), each in its own de-skewed frame; 0 if unknown."""
    likelihoods = methods.likelihoods
    if likelihoods is None:
        return np.zeros(len(found))
    if methods.deskew is None:  # all frames are the same
        return likelihoods(frames[0], found)
    alike = with_one_noise(found)
    return np.array([likelihoods(frame, [each])[0] for frame, each in zip(frames, alike, strict=True)])
