"""Composition of the output of a navigator's step: status, odometry, hypotheses, angles of joints."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import degrees

from scipy.spatial.transform import RigidTransform, Rotation

from rpod_pose.belief import SYMMETRY, Angle
from rpod_pose.measurement import Measurement
from rpod_pose.navigation.dynamics.options import evidence_of
from rpod_pose.navigation.filter import predict, to_odometry
from rpod_pose.navigation.joints import JointTrack
from rpod_pose.navigation.state import Cause, NavigatorState, Output, RefusedPixels
from rpod_pose.ports import Acquisition, Registration
from rpod_schemas.config.estimator.filter import FilterConfig
from rpod_schemas.poses import make_pose
from rpod_schemas.topics import CHASER, TARGET_ESTIMATE
from rpod_schemas.types import EstimatorStatus, Hypothesis, Joints, Odometry, Source
from rpod_target import Equivalence


class Results:
    """Composes the outputs of the steps.

    Args:
        config: configuration of the filter, which predicts to the frame's stamp.
        alike: which attitudes no measurement distinguishes; each estimate lists the poses of its turns as
            hypotheses, and no estimate turns about a free axis.
    """

    def __init__(self, config: FilterConfig, alike: Equivalence) -> None:
        self._config = config
        self._alike = alike
        self._turns = [make_pose(rotation=Rotation.from_matrix(turn)) for turn in alike.turns[1:]]

    def output(
        self,
        state: NavigatorState,
        event: Measurement,
        registration: Registration | None = None,
        *,
        reason: str = "",
        cause: Cause = Cause.OTHER,
        search: str = "",
        nis: float = float("nan"),
        found: Acquisition | None = None,
    ) -> Output:
        """Return the output of a measurement.

        Args:
            state: the state after it.
            event: the measurement.
            registration: result of the sensor's method; None if the frame was not registered.
            reason: why the pose was not accepted; empty if it was.
            cause: kind of this reason.
            search: report about a search of the sensor's frames; empty if there is none.
            nis: normalised innovation squared; NaN if the filter was not updated.
            found: the result of a search without a guess, where one was made.
        """
        reasons = "; ".join(filter(None, (reason, search)))
        measured = registration or Registration(Source.NONE)
        hypotheses = self._hypotheses(state, event, found)
        status = EstimatorStatus(
            stamp_ns=event.stamp_ns,
            frame_id=CHASER,
            mode=state.mode,
            source=measured.source,
            sensor=event.sensor,
            accepted=not reasons,
            reason=reasons,
            cost_m2=measured.cost_m2,
            nis=nis,
            inliers=measured.inliers,
            inlier_share=measured.inlier_share,
            ambiguous=len(hypotheses) > 1,
            hypotheses=hypotheses,
            belief=measured.belief.level,
            evidence=_evidence(state, measured),
        )
        marks = measured.belief.marks if reasons else None
        refused = RefusedPixels(event.data.frame_id, marks) if marks is not None else None
        odometry = self._odometry(state, event.stamp_ns)
        joints = _joints_at(state.joints, odometry.stamp_ns) if odometry else None
        used = registration if odometry and not reasons else None
        weak_support = "" if reasons else measured.belief.reason
        return Output(
            status,
            odometry,
            refused,
            joints,
            weak_support=weak_support,
            measured=used,
            cause=cause,
            search=search,
        )

    def silent(
        self, state: NavigatorState, stamp_ns: int, reason: str, *, sensor: str = ""
    ) -> tuple[NavigatorState, Output]:
        """Return state and output at a time without a measurement: the prediction, if there is a track."""
        odometry = self._odometry(state, stamp_ns)
        joints = _joints_at(state.joints, odometry.stamp_ns) if odometry else None
        status = EstimatorStatus(
            stamp_ns=stamp_ns, frame_id=CHASER, mode=state.mode, sensor=sensor, reason=reason
        )
        if odometry is not None:
            state = replace(state, shown_ns=odometry.stamp_ns)
        return state, Output(status, odometry, joints=joints)

    def _odometry(self, state: NavigatorState, stamp_ns: int) -> Odometry | None:
        """Return the estimate at a frame's stamp, or at that of the newest published one if it is later."""
        if not state.mode.has_track or state.history is None:
            return None
        newest = state.history.state
        shown = predict(newest, max(stamp_ns, newest.stamp_ns, state.shown_ns), self._config)
        return to_odometry(shown, frame_id=CHASER, child_frame_id=TARGET_ESTIMATE)

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
        return _equally_probable([pose, *(pose * turn for turn in self._turns)])


def _evidence(state: NavigatorState, measured: Registration) -> dict[str, float]:
    return {
        **measured.belief.evidence,
        **(state.rivals.evidence if state.rivals else {}),
        **_sigmas_deg(measured.angles),
        **(evidence_of(state.history.state) if state.history else {}),
    }


def _equally_probable(poses: Sequence[RigidTransform]) -> tuple[Hypothesis, ...]:
    names = ("", *[SYMMETRY] * (len(poses) - 1))
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
