"""One track: a tumbling target, measured poses with white noise, a gap, and the error at its end.

The measurements have the stated standard deviations and nothing else: no sensor, no target's model, no
correlation. So the figures are those of the filter and its models of motion alone.
"""

from dataclasses import dataclass, field, replace
from math import radians
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_motion.attitude import integrate_tumble
from rpod_motion.imu import Imu
from rpod_motion.motion import MARGIN_S, Motion
from rpod_motion.thrust import Thrusters
from rpod_motion.trajectories.approach import Approach
from rpod_motion.trajectories.station_keeping import StationKeeping
from rpod_motion.trajectories.synchronised import Slewing
from rpod_motion.trajectories.trajectory import Trajectory, TrajectoryState
from rpod_pose.navigation.dynamics.options import Dynamics
from rpod_pose.navigation.filter import FilterState, predict, start
from rpod_pose.navigation.history import History, apply
from rpod_pose.navigation.pose_measurement import PoseMeasurement
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.estimator.dynamics import DynamicsConfig
from rpod_schemas.config.estimator.filter import FilterConfig, FilterTuning
from rpod_schemas.config.motion import CommandErrorConfig, ImuNoiseConfig
from rpod_schemas.poses import make_pose, rotation_of
from rpod_target import Target

EPOCH_NS = 10**18
SLEW_RAD, SLEW_PERIOD_S = radians(10.0), 63.0
"""A slew with a rate of up to 1 deg/s."""
ORBIT_M = 7.144e6
AT_THEIR_WORD = FilterConfig(
    tuning=FilterTuning(correlation_inflation=1.0), position_floor_m=0.0, attitude_floor_deg=0.0
)
FREE_FLIGHT = AT_THEIR_WORD.model_copy(update={"acceleration_density_m2_s3": 1e-9})
"""For a chaser that does not thrust."""


@dataclass(frozen=True, eq=False)
class Course:
    """What happens, and what the filter knows of it."""

    target: Target
    rate_deg_s: float
    """Rate of the target, about a random axis."""
    dynamics: dict[str, Any]
    """The estimator's section ``dynamics``."""
    range_m: float = 5.0
    scans_hz: float = 15.0
    sigma_m: float = 0.003
    sigma_deg: float = 0.15
    tracked_s: float = 60.0
    gap_s: float = 30.0
    moments: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """Factors on the principal moments that the filter assumes, in rising order."""
    centre_off_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Error of the centre of mass that the filter assumes, target axes."""
    axis: tuple[float, float, float] | None = None
    """Axis of the rate, target axes; random if left out."""
    slews: bool = False
    holds_again: bool = False
    """Whether a slew ends after a quarter of its period, and the chaser then holds the attitude."""
    in_orbit: bool = False
    """Whether the chaser is on a safety ellipse about the target; otherwise both drift apart on a line."""
    imu: ImuNoiseConfig | None = None
    commands: CommandErrorConfig | None = None
    approach_m: float = 0.3
    """Way by which the chaser comes nearer, to the end of the gap."""
    thrusts: bool = False
    """Whether it speeds up for half of the time and brakes for the other half; else its speed is constant."""
    filter: FilterConfig = FREE_FLIGHT

    def assumed(self) -> Target:
        """Return the target as the filter assumes it."""
        moments, axes = np.linalg.eigh(self.target.inertia_kg_m2)
        return replace(
            self.target,
            inertia_kg_m2=(axes * (moments * np.array(self.moments))) @ axes.T,
            centre_of_mass_m=self.target.centre_of_mass_m + np.array(self.centre_off_m),
        )


@dataclass(frozen=True, eq=False)
class Result:
    """Errors of a track."""

    attitude_deg: float
    """At the end of the gap."""
    position_m: float
    sigma_deg: float
    """Standard deviation of the attitude there, root of the sum over the axes."""
    sigma_m: float
    nees: float
    refused: int
    """Number of measurements that the gate refused."""
    tracked_deg: float
    """RMS over the second half of the track."""
    tracked_m: float
    tracked_nees: float
    """Mean over the second half of the track."""
    worst_deg: float
    """Largest error of the track after its first two seconds."""
    worst_m: float
    state: FilterState = field(repr=False)
    """State after the last measurement."""
    imu: Imu | None = None
    thrusters: Thrusters | None = None


class SlewingOnce(Slewing):
    """A slew that ends where its rate is zero for the first time."""

    def state(self, time_s: float) -> TrajectoryState:
        """Return the state at a time from the epoch."""
        period_s = max(self.period_s, 4.0 * time_s)
        return Slewing(self.path, self.axis, self.amplitude_rad, period_s).state(time_s)


def fly(course: Course, seed: int) -> Result:
    """Return the errors of a track; the seed chooses attitude, axis, noise and biases."""
    generator = np.random.default_rng((seed, 17))
    motion = _motion(course, generator)
    imu = thrusters = None
    centre_m = course.target.centre_of_mass_m
    if course.imu is not None:
        imu = Imu(course.imu, motion, centre_of_mass_m=centre_m, seed=seed)
    if course.commands is not None:
        thrusters = Thrusters(course.commands, motion, centre_of_mass_m=centre_m, seed=seed)
    dynamics = Dynamics.of(DynamicsConfig.model_validate(course.dynamics), course.assumed())
    feed = _Feed(dynamics, imu, thrusters)
    state, offs, squares, refused = None, [], [], 0
    for number in range(round(course.tracked_s * course.scans_hz) + 1):
        time_s = number / course.scans_hz
        feed.up_to(time_s)
        truth = motion.state(time_s).T_chaser_target
        measured, covariance = _measured(course, truth, generator)
        if state is None:
            state = start(
                measured, covariance, _stamp(time_s), config=course.filter,
                centre_of_mass_m=course.assumed().centre_of_mass_m,
                blocks=dynamics.blocks_at(_stamp(time_s)), model=dynamics.model,
            )  # fmt: skip
            continue
        pose = PoseMeasurement(_stamp(time_s), measured, covariance, alone=True)
        applied = apply(History(state), pose, course.filter)
        state, refused = applied.history.state, refused + (not applied.accepted)
        off = _error(state, truth)
        offs.append(off)
        squares.append(float(off @ np.linalg.solve(state.covariance[:6, :6], off)))
    assert state is not None  # noqa: S101 - there is a first measurement
    end_s = course.tracked_s + course.gap_s
    feed.up_to(end_s)
    after = predict(state, _stamp(end_s), course.filter)
    off, P = _error(after, motion.state(end_s).T_chaser_target), after.covariance[:6, :6]
    late = np.array(offs[len(offs) // 2 :])
    settled = np.array(offs[min(round(2.0 * course.scans_hz), len(offs) - 1) :])
    return Result(
        attitude_deg=float(np.degrees(np.linalg.norm(off[3:]))),
        position_m=float(np.linalg.norm(off[:3])),
        sigma_deg=float(np.degrees(np.sqrt(P[3:, 3:].trace()))),
        sigma_m=float(np.sqrt(P[:3, :3].trace())),
        nees=float(off @ np.linalg.solve(P, off)),
        refused=refused,
        tracked_deg=float(np.degrees(np.sqrt((late[:, 3:] ** 2).sum(axis=1).mean()))),
        tracked_m=float(np.sqrt((late[:, :3] ** 2).sum(axis=1).mean())),
        tracked_nees=float(np.mean(squares[len(offs) // 2 :])),
        worst_deg=float(np.degrees(np.linalg.norm(settled[:, 3:], axis=1).max())),
        worst_m=float(np.linalg.norm(settled[:, :3], axis=1).max()),
        state=state,
        imu=imu,
        thrusters=thrusters,
    )


class _Feed:
    """Passes readings of the IMU and commands to the track, as far as time has come."""

    def __init__(self, dynamics: Dynamics, imu: Imu | None, thrusters: Thrusters | None) -> None:
        self._dynamics, self._imu, self._thrusters = dynamics, imu, thrusters
        self._measured = self._commanded = 0

    def up_to(self, time_s: float) -> None:
        imu, thrusters = self._imu, self._thrusters
        while imu is not None and self._dynamics.imu is not None:
            at_s = self._measured / imu.rate_hz
            if at_s > time_s:
                break
            self._dynamics.imu.take(imu.reading(_stamp(at_s), at_s))
            self._measured += 1
        while thrusters is not None and self._dynamics.commands is not None:
            at_s = self._commanded / thrusters.rate_hz
            if at_s > time_s:
                break
            self._dynamics.commands.take(thrusters.command(_stamp(at_s), at_s))
            self._commanded += 1


def _motion(course: Course, generator: np.random.Generator) -> Motion:
    """Return the motion: the centre of mass drifts on a line, or is circled in orbit."""
    duration_s, centre_m = course.tracked_s + course.gap_s + 1.0, course.target.centre_of_mass_m
    drawn = generator.standard_normal(3)
    axis = np.array(course.axis if course.axis is not None else drawn)
    path: Trajectory
    if course.in_orbit:
        path = StationKeeping.on_safety_ellipse(
            centre_m, least_range_m=20.0, greatest_range_m=50.0, phase_rad=radians(20.0),
            semi_major_axis_m=ORBIT_M, inclination_rad=radians(98.5),
        )  # fmt: skip
    else:
        end_m = np.array([0.05, 0.0, course.range_m - course.approach_m])
        ramp_share = 0.5 if course.thrusts else 0.0
        start_m = np.array([0.0, 0.0, course.range_m])
        path = Approach(start_m, end_m, duration_s, ramp_share, anchor_m=centre_m)
    if course.slews:
        kind = SlewingOnce if course.holds_again else Slewing
        path = kind(path, np.array([0.0, 1.0, 0.0]), SLEW_RAD, SLEW_PERIOD_S)
    attitude = integrate_tumble(
        quaternion_xyzw=Rotation.random(random_state=generator).as_quat(),
        rate_rad_s=radians(course.rate_deg_s) * axis / np.linalg.norm(axis),
        inertia_kg_m2=course.target.inertia_kg_m2,
        span_s=(-MARGIN_S, duration_s + MARGIN_S),
    )
    return Motion(path, attitude, np.zeros(3), duration_s)


def _measured(
    course: Course, truth: RigidTransform, generator: np.random.Generator
) -> tuple[RigidTransform, FloatArray]:
    sigma = np.repeat([course.sigma_m, radians(course.sigma_deg)], 3)
    error = sigma * generator.standard_normal(6)
    rotation = Rotation.from_rotvec(error[3:]) * rotation_of(truth)
    return make_pose(rotation=rotation, translation_m=truth.translation + error[:3]), np.diag(sigma**2)


def _error(state: FilterState, truth: RigidTransform) -> FloatArray:
    """Return (dp, dtheta) of a state, shape (6,)."""
    turn = rotation_of(state.T_chaser_target) * rotation_of(truth).inv()
    return np.concatenate([state.T_chaser_target.translation - truth.translation, turn.as_rotvec()])


def _stamp(time_s: float) -> int:
    return EPOCH_NS + round(time_s * 1e9)
