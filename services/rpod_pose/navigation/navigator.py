"""The navigator: a pure state machine from measurements to estimates.

ACQUIRING  --a refined candidate is accepted-->             VERIFYING
VERIFYING  --the next frames agree-->                       TRACKING
TRACKING   --rejections or silence for too long, or
             too many frames inconsistent with the pose-->  LOST
LOST       --accepted near the prediction, or found-->      VERIFYING

``step(state, measurement) -> (state, output)`` knows neither bus nor clock: the daemon, a replay
of a log and a Monte-Carlo campaign run the same function.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from math import degrees, radians
from typing import overload

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_pose.belief import SYMMETRY, Record
from rpod_pose.measurement import Measurement, Tick
from rpod_pose.navigation.filter import ATTITUDE, FilterState, predict, start, to_odometry
from rpod_pose.navigation.history import History, PoseMeasurement, apply
from rpod_pose.navigation.joints import JointTrack, tracked_joints
from rpod_pose.navigation.rivals import Rival, Rivals, distinct
from rpod_pose.navigation.state import Challenger, GivenPose, NavigatorState, Output, RefusedPixels
from rpod_pose.ports import Acquisition, Angle, Deskew, Methods, Registration
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.estimator import EstimatorSettings
from rpod_schemas.messages import NANOSECONDS
from rpod_schemas.poses import chained, make_pose, pose_error, rotation_matrix
from rpod_schemas.topics import CHASER, TARGET_ESTIMATE
from rpod_schemas.types import EstimatorStatus, Hypothesis, Joints, Mode, SensorFrame, Source
from rpod_target import NO_SYMMETRY, Equivalence, Joint

LATE = "late: older than the filter's history"
"""Reason for which a measurement is not used."""
BEGINNING = 0.5
"""Factor on the share at which a track is lost, below which one may begin, so that tracks do not flicker."""
EXPLAINED_DEG, EXPLAINED_M = 20.0, 0.5
"""Greatest turn and way from a prediction to a pose that an accelerated target explains: 60 deg/s2 and 3 m/s2
turn it by 7 deg and move it by 0.4 m in half a second, and attitudes that are mistaken for each other are
farther apart."""
CONTESTED_S = 0.2
"""Time of believed poses that agree on another attitude after which a track is lost."""
_GIVEN_SIGMA_M, _GIVEN_SIGMA_RAD = 0.05, 0.26
"""Standard deviations of a given first pose without a given covariance."""


class Navigator:
    """The transitions; its only state is its configuration and data of the target.

    Args:
        settings: settings of the estimator.
        methods: methods of each sensor, by its name.
        centre_of_mass_m: centre of mass of the target, target axes, shape (3,).
        alike: which attitudes of the target no measurement tells apart; each estimate lists the poses that
            the turns give, and leaves the angle about a free axis as it is.
        joints: joints of the target, whose angles are estimated.
    """

    def __init__(
        self,
        settings: EstimatorSettings,
        methods: Mapping[str, Methods],
        *,
        centre_of_mass_m: FloatArray,
        alike: Equivalence = NO_SYMMETRY,
        joints: Sequence[Joint] = (),
    ) -> None:
        self._settings = settings
        self._alike = alike
        self._turns = [make_pose(rotation=Rotation.from_matrix(turn)) for turn in alike.turns[1:]]
        self._start_filter = partial(
            start, config=settings.filter, centre_of_mass_m=centre_of_mass_m, alike=alike
        )
        self._limits = settings.navigator
        self._methods = methods
        self._joints = {joint.name: joint for joint in joints}

    def start(
        self,
        pose: RigidTransform | None = None,
        *,
        covariance: FloatArray | None = None,
        stamp_ns: int | None = None,
    ) -> NavigatorState:
        """Return the first state: searching, or waiting for a frame to verify a given pose."""
        if pose is None:
            return NavigatorState()
        if covariance is None:
            covariance = np.diag([_GIVEN_SIGMA_M**2] * 3 + [_GIVEN_SIGMA_RAD**2] * 3)
        return NavigatorState(mode=Mode.VERIFYING, given=GivenPose(pose, covariance, stamp_ns))

    @overload
    def step(self, state: NavigatorState, event: Measurement) -> tuple[NavigatorState, Output]: ...
    @overload
    def step(self, state: NavigatorState, event: Tick) -> tuple[NavigatorState, Output | None]: ...
    def step(self, state: NavigatorState, event: Measurement | Tick) -> tuple[NavigatorState, Output | None]:
        """Return the next state and the output to publish; no output for a tick that changes nothing."""
        if isinstance(event, Tick):
            return self._let_time_pass(state, event)
        state, output = self._take(replace(state, heard_ns=max(state.heard_ns, event.stamp_ns)), event)
        if output.odometry is not None:
            state = replace(state, shown_ns=output.odometry.stamp_ns)
        return state, output

    def _take(self, state: NavigatorState, event: Measurement) -> tuple[NavigatorState, Output]:
        if state.given is not None:
            state = self._start_at_given(state, event)
        if state.rivals is not None:
            return self._compare(state, state.rivals, event)
        if state.mode == Mode.ACQUIRING or state.history is None:
            return self._acquire(state, event)
        predicted = state.history.at(event.stamp_ns, self._settings.filter)
        if predicted is None:
            return state, self._output(state, event, reason=LATE)
        if state.mode == Mode.LOST:
            return self._recover(state, predicted, event)
        return self._track(state, state.history, predicted, event)

    # --- ACQUIRING ---

    def _acquire(self, state: NavigatorState, event: Measurement) -> tuple[NavigatorState, Output]:
        """Search without a guess; begin a track if one pose explains the measurement."""
        found = self._methods_for(state, event).acquirer.acquire(event.data)
        if found.begins_track:
            return self._begin(state, event, found.registration)
        if self._methods[event.sensor].likelihoods is not None:
            tracks = distinct(self._started(event, found), self._alike)
            if 1 < len(tracks) <= self._limits.tuning.most_rivals:
                rivals = Rivals(tracks, event.stamp_ns, event.stamp_ns, found.belief.needed_weight)
                state = replace(state, rivals=rivals)
        return state, self._output(state, event, found.registration, reason=found.belief.refusal, found=found)

    def _begin(
        self, state: NavigatorState, event: Measurement, registration: Registration
    ) -> tuple[NavigatorState, Output]:
        pose, covariance = in_chaser(registration, event.T_chaser_sensor)
        unverified = self._limits.confirmations > 0 or not self._is_credible(state, event)
        state = replace(
            state,
            mode=Mode.VERIFYING if unverified else Mode.TRACKING,
            history=History(self._start_filter(pose, covariance, event.stamp_ns)),
            accepted_ns=event.stamp_ns,
            rejections=0,
            confirmations=0,
            joints=self._tracked_joints(state, event, registration),
        )
        return state, self._output(state, event, registration)

    def _started(self, event: Measurement, found: Acquisition) -> list[Rival]:
        """Return a rival for each pose that explains a frame; empty if none does."""
        if found.pose is None:
            return []
        _, covariance = in_chaser(found.registration, event.T_chaser_sensor)
        return [
            Rival(
                History(
                    self._start_filter(chained(event.T_chaser_sensor, each.pose), covariance, event.stamp_ns)
                ),
                each.log_likelihood,
            )
            for each in found.hypotheses
        ]

    # --- rivals ---

    def _compare(
        self, state: NavigatorState, rivals: Rivals, event: Measurement
    ) -> tuple[NavigatorState, Output]:
        """Track each rival; begin a track if one of them remains, also beside those of a new search."""
        if rivals.tracks[0].history.before(event.stamp_ns, self._settings.filter) is None:
            return state, self._output(state, event, reason=LATE)
        apart_s = (event.stamp_ns - rivals.since_ns) / NANOSECONDS
        left = self._tracked(rivals, event)
        if not left or apart_s > self._limits.tuning.rivals_s:
            return self._acquire(replace(state, rivals=None), event)
        tracks = distinct([rival for rival, _ in left], self._alike)
        registration = next(seen for rival, seen in left if rival is tracks[0])
        rivals = rivals._replace(
            tracks=tracks,
            newest_ns=max(rivals.newest_ns, event.stamp_ns),
            frames=rivals.frames + 1,
        )
        if rivals.decided and registration.begins_track and self._is_confident(tracks[0].state):
            others = self._searched_again(rivals, event)
            rivals = rivals.joined_by(others, self._alike)
            if others and rivals.decided:
                return self._begin_remaining(state, rivals, event, registration)
        if len(rivals.tracks) > self._limits.tuning.most_rivals:
            state = replace(state, rivals=None)
        else:
            state = replace(state, rivals=rivals)
        return state, self._output(state, event, registration, reason=rivals.reason(self._alike))

    def _tracked(self, rivals: Rivals, event: Measurement) -> list[tuple[Rival, Registration]]:
        """Return the rivals that explain a frame, each with its registration."""
        methods, config = self._methods[event.sensor], self._settings.filter
        left, frames, poses = [], [], []
        for rival in rivals.tracks:
            predicted = rival.history.at(event.stamp_ns, config)
            if predicted is None:
                continue
            frame = as_of_stamp(event, predicted, methods.deskew)
            prediction = chained(event.T_chaser_sensor.inv(), predicted.T_chaser_target)
            registration = methods.tracker.track(frame, prediction)
            if registration.T_sensor_target is None or not registration.continues_track:
                continue
            measured = PoseMeasurement(event.stamp_ns, *in_chaser(registration, event.T_chaser_sensor))
            applied = apply(rival.history, measured, config, predicted)
            if applied.accepted:
                left.append((replace(rival, history=applied.history), registration))
                frames.append(frame)
                poses.append(registration.T_sensor_target)
        share = rivals.share_of_frame(event.stamp_ns, config.correlation_inflation)
        logs = share * _likelihoods(methods, frames, poses)
        return [
            (replace(rival, log_evidence=rival.log_evidence + log), registration)
            for (rival, registration), log in zip(left, logs.tolist(), strict=True)
        ]

    def _searched_again(self, rivals: Rivals, event: Measurement) -> list[Rival]:
        """Return what a search finds in the frame that decides; empty if it finds nothing.

        The first search may have missed the right pose, or its track may have been lost since.
        """
        methods = self._methods[event.sensor]
        data = as_of_stamp(event, rivals.tracks[0].state, methods.deskew)
        return self._started(event, methods.acquirer.acquire(data))

    def _begin_remaining(
        self, state: NavigatorState, rivals: Rivals, event: Measurement, registration: Registration
    ) -> tuple[NavigatorState, Output]:
        verified = rivals.frames >= self._limits.confirmations and self._is_credible(state, event)
        state = replace(
            state,
            mode=Mode.TRACKING if verified else Mode.VERIFYING,
            rivals=None,
            history=rivals.tracks[0].history,
            accepted_ns=event.stamp_ns,
            rejections=0,
            confirmations=rivals.frames,
        )
        return state, self._output(state, event, registration)

    def _methods_for(self, state: NavigatorState, event: Measurement) -> Methods:
        """Return the sensor's methods, which expect the target's joints where their tracks predict them."""
        methods = self._methods[event.sensor]
        if methods.expecting is None or not state.joints:
            return methods
        return methods.expecting(
            {name: track.at(event.stamp_ns).angle for name, track in state.joints.items()}
        )

    def _tracked_joints(
        self, state: NavigatorState, event: Measurement, registration: Registration
    ) -> Mapping[str, JointTrack]:
        return tracked_joints(state.joints, self._joints, registration.angles, event.stamp_ns)

    def _start_at_given(self, state: NavigatorState, event: Measurement) -> NavigatorState:
        given = state.given
        assert given is not None  # noqa: S101 - guaranteed by the caller
        stamp_ns = event.stamp_ns if given.stamp_ns is None else min(given.stamp_ns, event.stamp_ns)
        return replace(
            state,
            mode=Mode.VERIFYING,
            given=None,
            history=History(self._start_filter(given.T_chaser_target, given.covariance, stamp_ns)),
            accepted_ns=stamp_ns,
            confirmations=self._limits.confirmations - 1,
        )

    # --- VERIFYING and TRACKING ---

    def _track(
        self, state: NavigatorState, history: History, predicted: FilterState, event: Measurement
    ) -> tuple[NavigatorState, Output]:
        """Register from the prediction, accept or reject the pose, update the filter."""
        registration, reason = self._register(state, event, predicted, tracked=state.mode == Mode.TRACKING)
        record = state.records.get(event.sensor, Record())
        if registration.T_sensor_target is not None:
            record = record.after(registration.belief)
        state = replace(state, records={**state.records, event.sensor: record})
        if state.mode == Mode.TRACKING and record.share > self._limits.tuning.max_contradicted_share:
            share = f"{record.share:.0%} of the recent frames do not support the tracked pose"
            state = replace(state, mode=Mode.LOST, lost_ns=event.stamp_ns)
            return self._reject(state, event, registration, reason=f"{share}: {reason}" if reason else share)
        if reason:
            return self._reject(state, event, registration, reason=reason)
        pose, covariance = in_chaser(registration, event.T_chaser_sensor)
        measured = PoseMeasurement(event.stamp_ns, pose, covariance)
        grown, nis, accepted = apply(history, measured, self._settings.filter, predicted)
        if not accepted:
            state = replace(
                state, history=grown
            )  # a measurement that comes later may make this one consistent
            if state.mode == Mode.TRACKING and registration.begins_track:
                state, taken = self._challenge(state, predicted, measured)
                if taken or state.mode == Mode.LOST:
                    reason = "" if taken else "believed poses agree on another attitude than the tracked one"
                    return state, self._output(state, event, registration, reason=reason, nis=nis)
            return self._reject(state, event, registration, reason=f"gate: nis {nis:.1f}", nis=nis)
        confirmations = state.confirmations + 1
        verified = confirmations >= self._limits.confirmations and self._is_credible(state, event)
        tracking = state.mode == Mode.TRACKING or verified
        state = replace(
            state,
            mode=Mode.TRACKING if tracking else Mode.VERIFYING,
            history=grown,
            accepted_ns=max(state.accepted_ns, event.stamp_ns),
            rejections=0,
            confirmations=confirmations,
            challenger=None,
            joints=self._tracked_joints(state, event, registration),
        )
        return state, self._output(state, event, registration, nis=nis)

    def _challenge(
        self, state: NavigatorState, predicted: FilterState, measured: PoseMeasurement
    ) -> tuple[NavigatorState, bool]:
        """Return the state after a believed pose that the gate refused, and whether the track goes on at it.

        Two such poses in succession that agree with each other are evidence against the prediction, whose
        target has been accelerated: the track goes on at the second. If they lie so far off that no
        acceleration explains it, either of both may be wrong, and the track is lost after a while.
        """
        filtered, stamp_ns = self._settings.filter, measured.stamp_ns
        challenger = state.challenger
        applied = None if challenger is None else apply(challenger.history, measured, filtered)
        if challenger is None or applied is None or not applied.accepted:
            started = self._start_filter(measured.T_chaser_target, measured.covariance, stamp_ns)
            moving = replace(started, velocity_m_s=predicted.velocity_m_s, rate_rad_s=predicted.rate_rad_s)
            challenger = Challenger(History(moving), stamp_ns)
            return replace(state, challenger=challenger), False
        turn_rad, shift_m = (
            float(np.linalg.norm(part))
            for part in pose_error(predicted.T_chaser_target, measured.T_chaser_target)
        )
        state = replace(state, challenger=replace(challenger, history=applied.history))
        if turn_rad <= radians(EXPLAINED_DEG) and shift_m <= EXPLAINED_M:
            return replace(
                state, history=applied.history, accepted_ns=stamp_ns, rejections=0, challenger=None
            ), True
        if (stamp_ns - challenger.since_ns) / NANOSECONDS >= CONTESTED_S:
            state = replace(state, mode=Mode.LOST, lost_ns=stamp_ns, challenger=None)
        return state, False

    def _register(
        self, state: NavigatorState, event: Measurement, predicted: FilterState, *, tracked: bool
    ) -> tuple[Registration, str]:
        """Return the registration from the prediction, and the reason why it is not accepted.

        If the registration fails, the surroundings of the prediction are searched, unless a track predicts
        the attitude confidently: while no twist is known, or after a gap, the prediction may be far off.
        """
        methods = self._methods_for(state, event)
        T_sensor_target = chained(event.T_chaser_sensor.inv(), predicted.T_chaser_target)
        data = as_of_stamp(event, predicted, methods.deskew)
        registration = methods.tracker.track(data, T_sensor_target)
        if registration.continues_track if tracked else registration.begins_track:
            return registration, ""
        if not (tracked and self._is_confident(predicted)):
            found = methods.acquirer.near(data, T_sensor_target)
            if found.begins_track:
                return found.registration, ""
        return registration, registration.belief.refusal

    def _is_confident(self, predicted: FilterState) -> bool:
        sigma_rad = float(np.sqrt(np.linalg.eigvalsh(predicted.covariance[ATTITUDE, ATTITUDE])[-1]))
        return sigma_rad <= radians(self._limits.tuning.vague_deg)

    def _reject(
        self,
        state: NavigatorState,
        event: Measurement,
        registration: Registration,
        *,
        reason: str,
        nis: float = float("nan"),
    ) -> tuple[NavigatorState, Output]:
        """Continue with the prediction; drop a pose that fails verification; lose a track after a while."""
        state = replace(state, rejections=state.rejections + 1)
        if state.mode == Mode.VERIFYING:
            state = replace(state, mode=Mode.ACQUIRING, history=None)
        elif state.mode == Mode.TRACKING and self._lost(state, event.stamp_ns):
            state = replace(state, mode=Mode.LOST, lost_ns=event.stamp_ns)
        return state, self._output(state, event, registration, reason=reason, nis=nis)

    def _is_credible(self, state: NavigatorState, event: Measurement) -> bool:
        """Return whether a track may begin: few recent frames of the sensor were inconsistent."""
        share = state.records.get(event.sensor, Record()).share
        return share <= BEGINNING * self._limits.tuning.max_contradicted_share

    def _lost(self, state: NavigatorState, stamp_ns: int) -> bool:
        silent_s = (stamp_ns - state.accepted_ns) / NANOSECONDS
        return (
            silent_s > self._limits.rejection_timeout_s and state.rejections >= self._limits.rejected_frames
        )

    # --- LOST ---

    def _recover(
        self, state: NavigatorState, predicted: FilterState, event: Measurement
    ) -> tuple[NavigatorState, Output]:
        """Search near the prediction first, then everywhere."""
        if (event.stamp_ns - state.lost_ns) / NANOSECONDS <= self._limits.near_search_s:
            registration, why = self._register(state, event, predicted, tracked=False)
            if not why:
                return self._begin(state, event, registration)
        return self._acquire(state, event)

    def _let_time_pass(self, state: NavigatorState, tick: Tick) -> tuple[NavigatorState, Output | None]:
        silent_s = (tick.stamp_ns - state.heard_ns) / NANOSECONDS
        if state.mode != Mode.TRACKING or silent_s <= self._limits.silence_timeout_s:
            return state, None
        state = replace(state, mode=Mode.LOST, lost_ns=tick.stamp_ns)
        status = EstimatorStatus(
            stamp_ns=tick.stamp_ns,
            frame_id=CHASER,
            mode=Mode.LOST,
            reason=f"no measurement for {silent_s:.1f} s",
        )
        return state, Output(status, None)

    # --- results ---

    def _output(
        self,
        state: NavigatorState,
        event: Measurement,
        registration: Registration | None = None,
        *,
        reason: str = "",
        nis: float = float("nan"),
        found: Acquisition | None = None,
    ) -> Output:
        measured = registration or Registration(Source.NONE)
        hypotheses = self._hypotheses(state, event, found)
        status = EstimatorStatus(
            stamp_ns=event.stamp_ns,
            frame_id=CHASER,
            mode=state.mode,
            source=measured.source,
            sensor=event.sensor,
            accepted=not reason,
            reason=reason,
            cost_m2=measured.cost_m2,
            nis=nis,
            inliers=measured.inliers,
            inlier_share=measured.inlier_share,
            ambiguous=len(hypotheses) > 1,
            hypotheses=hypotheses,
            belief=measured.belief.level,
            evidence={
                **measured.belief.evidence,
                **(state.rivals.evidence if state.rivals else {}),
                **_sigmas_deg(measured.angles),
            },
        )
        marks = measured.belief.marks if reason else None
        refused = RefusedPixels(event.data.frame_id, marks) if marks is not None else None
        if state.mode != Mode.TRACKING or state.history is None:
            return Output(status, None, refused)
        newest = state.history.state
        stamp_ns = max(event.stamp_ns, newest.stamp_ns, state.shown_ns)
        shown = predict(newest, stamp_ns, self._settings.filter)
        odometry = to_odometry(shown, frame_id=CHASER, child_frame_id=TARGET_ESTIMATE)
        return Output(status, odometry, refused, _joints_at(state.joints, stamp_ns))

    def _hypotheses(
        self, state: NavigatorState, event: Measurement, found: Acquisition | None
    ) -> tuple[Hypothesis, ...]:
        """Return the T_chaser_target that explain the frame: as acquired, or by exact symmetries."""
        if found is not None:
            return tuple(
                item.model_copy(update={"pose": event.T_chaser_sensor * item.pose})
                for item in found.hypotheses
            )
        if state.rivals is not None:
            return state.rivals.hypotheses(self._alike)
        if not self._turns or state.history is None:
            return ()
        pose = state.history.state.T_chaser_target
        poses = (pose, *(pose * turn for turn in self._turns))
        names = ("", *[SYMMETRY] * len(self._turns))
        return tuple(
            Hypothesis(pose=pose, weight=1.0 / len(poses), name=name, log_likelihood=0.0)
            for pose, name in zip(poses, names, strict=True)
        )


def _sigmas_deg(angles: Mapping[str, Angle]) -> dict[str, float]:
    return {f"joint_{name}_sigma_deg": degrees(angle.sigma_rad) for name, angle in angles.items()}


def _joints_at(tracks: Mapping[str, JointTrack], stamp_ns: int) -> Joints | None:
    """Return the angles at a time; None for a target without joints."""
    if not tracks:
        return None
    there = {name: track.at(stamp_ns) for name, track in tracks.items()}
    return Joints(
        stamp_ns=stamp_ns,
        angle_rad={name: track.angle.angle_rad for name, track in there.items()},
        rate_rad_s={name: float(track.state[1]) for name, track in there.items()},
    )


def as_of_stamp(measurement: Measurement, predicted: FilterState, deskew: Deskew | None) -> SensorFrame:
    """Return the frame as of its stamp: de-skewed with the predicted twist if the sensor kind needs it.

    Before the second frame the predicted twist is zero, and the frame stays as it is.
    """
    if deskew is None:
        return measurement.data
    T_sensor_chaser = measurement.T_chaser_sensor.inv()
    R_sensor_chaser = rotation_matrix(T_sensor_chaser)
    deskewed: SensorFrame = deskew(
        measurement.data,
        chained(T_sensor_chaser, predicted.T_chaser_target),
        velocity_m_s=R_sensor_chaser @ predicted.velocity_m_s,
        rate_rad_s=R_sensor_chaser @ predicted.rate_rad_s,
    )
    return deskewed


def _likelihoods(
    methods: Methods, frames: Sequence[SensorFrame], poses: Sequence[RigidTransform]
) -> FloatArray:
    """Return the log likelihoods of poses, shape (N,), each in its own de-skewed frame; 0 if unknown."""
    likelihoods = methods.likelihoods
    if likelihoods is None or not frames:
        return np.zeros(len(poses))
    if methods.deskew is None:  # all frames are the same
        return likelihoods(frames[0], poses)
    return np.array([likelihoods(frame, [pose])[0] for frame, pose in zip(frames, poses, strict=True)])


def in_chaser(
    registration: Registration, T_chaser_sensor: RigidTransform
) -> tuple[RigidTransform, FloatArray]:
    """Return pose and covariance of a registration in the chaser's axes (ICD section 1)."""
    assert registration.T_sensor_target is not None  # noqa: S101 - guaranteed by the caller
    R = rotation_matrix(T_chaser_sensor)
    turn = np.zeros((6, 6))
    turn[:3, :3] = turn[3:, 3:] = R
    return chained(T_chaser_sensor, registration.T_sensor_target), turn @ registration.covariance @ turn.T
