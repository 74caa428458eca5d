"""A chaser that turns although nothing measures it: a held attitude is given up, and assumed again later.

Without ``chaser/imu`` a chaser is assumed to hold its attitude (``chaser.Held``). Before a chaser that slews,
Euler's equations and those of the orbit do not hold in its axes, and the models state their own noise, which
no factor raises. So a track would be lost, or wrong by many times its covariance.

A second filter continues beside such a track, with a constant rate as seen from the chaser and the densities
of the configuration. It follows a slew. Each filter states the density of a pose before it uses this pose.
The logarithm of the ratio is added up, and may not fall below zero: Page's test for a change at an unknown
time (E. S. Page, Continuous inspection schemes, Biometrika 41, 1954). Beyond its limit, the chaser has
turned, and the second filter is the track.

Commanded accelerations (``command_track``) are an assumption of the same kind: thrusters may fail. So the
second filter continues beside a track with commands too. With a gyro, the chaser's rotation is measured and
no assumption, so that this filter keeps the gyro, and lacks the commands alone.

A chaser that stops may be assumed to hold its attitude again. So the model with the held attitude begins anew
beside the track, from the track's state and the priors of its further states, as often as poses contradict
it. It is the track again when it was beside for ``HELD_S``, and the poses favour it beyond the same limit.
"""

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from math import log
from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc

from rpod_pose.navigation.dynamics.chaser import Held
from rpod_pose.navigation.dynamics.command_track import Commanded
from rpod_pose.navigation.dynamics.free_motion import FORCE_ERRORS, STATES, FreeMotion
from rpod_pose.navigation.dynamics.imu_track import ImuTrack
from rpod_pose.navigation.dynamics.steady import LEAST, log_density
from rpod_pose.navigation.filter import (
    CALM,
    NO_INNOVATIONS,
    POSE,
    TWIST,
    Block,
    FilterState,
    Innovation,
    Motion,
    MotionModel,
    Other,
    gate_nis,
    grown,
    predict,
)
from rpod_pose.navigation.filter.blocks import unknown
from rpod_pose.navigation.filter.prediction import constant_twist
from rpod_pose.navigation.filter.rotations import cross_matrix
from rpod_pose.navigation.pose_measurement import PoseMeasurement, compared
from rpod_schemas.config.estimator.filter import FilterConfig
from rpod_schemas.messages import NANOSECONDS

HELD_S = 60.0
"""Time for which a chaser must have held its attitude until this is assumed again, s. Physics: a slew by 60
deg at 1 deg/s; while its rate is constant, poses contradict a held attitude but slowly."""
CHASER_TURNS, COMMAND_DOUBTED = "chaser_turns", "command_doubted"
"""Names in the status's evidence for a chaser that turns although a held attitude was assumed, and for
commanded accelerations that poses contradict."""
_TURNS = "the chaser turns without a known rate, so that no gap is bridged (set dynamics.imu)"
_DOUBTED = (
    "the chaser does not move as guidance/command says, so that {} (check its thrusters, and axes, sign and "
    "stamps of the commands{})"
)
_NO_GAP, _BY_GYRO = (
    "no gap is bridged",
    "its acceleration is unknown and gaps are bridged for a short time only, with the gyro",
)
_IMU = "chaser/imu (axes, sign, rad/s, stamps)"
_OR_TURNS = "; if the chaser turns, set dynamics.imu"
_REFUSALS = 3.0
"""Number of right poses that the gate refuses by chance in succession as rarely as the filters are exchanged
by chance. Physics: a millionth of the frames, which is once in six hours at 45 Hz."""


@dataclass(frozen=True, eq=False)
class Turning:
    """Model of motion (``MotionModel``) while poses contradict what is assumed of the chaser.

    Velocity and rate are constant as seen from the chaser, with the densities of the configuration. If a gyro
    measures the chaser's rotation, they are those of a free target instead, and the density of the
    accelerations alone is that of the configuration.
    """

    held: FreeMotion
    """The model that assumes a held attitude, or commands that are executed."""
    blocks: tuple[Block, ...]
    """Its further states that are left out here, before any measurement."""
    measured: FreeMotion | None = None
    """The model with what is measured of the chaser, its rotation; None if nothing is."""

    @property
    def states_noise(self) -> tuple[bool, bool]:
        """Whether it states the noise itself: at most that of angular accelerations."""
        return (False, False) if self.measured is None else self.measured.states_noise

    def __call__(self, state: FilterState, step_s: float, config: FilterConfig) -> Motion:
        """Return the motion of a state in a step.

        An angular acceleration of the chaser also moves the target's origin, by more the farther it is. A
        density of accelerations below the default is that of free flight, which turning axes do not show.
        """
        least = FilterConfig().acceleration_density_m2_s3
        if config.acceleration_density_m2_s3 < least:
            config = config.model_copy(update={"acceleration_density_m2_s3": least})
        if self.measured is not None:
            return self.measured(state, step_s, config)
        motion = constant_twist(state, step_s, config)
        by = np.vstack([cross_matrix(motion.state.T_chaser_target.translation), -np.eye(3)])
        density = config.angular_acceleration_density_rad2_s3 * by @ by.T
        motion.noise[POSE, POSE] += step_s**3 / 3.0 * density
        motion.noise[POSE, TWIST] += step_s**2 / 2.0 * density
        motion.noise[TWIST, POSE] += step_s**2 / 2.0 * density
        motion.noise[TWIST, TWIST] += step_s * density
        return motion


def turns(state: FilterState) -> bool:
    """Return whether poses contradict what is assumed of the chaser: a held attitude, or its commands."""
    return isinstance(state.model, Turning)


def doubts(state: FilterState) -> tuple[str, ...]:
    """Return what poses contradict about the chaser, by the names for the evidence."""
    if not isinstance(state.model, Turning):
        return ()
    chaser = state.model.held.chaser
    if not isinstance(chaser, Commanded):
        return (CHASER_TURNS,)
    return (CHASER_TURNS, COMMAND_DOUBTED) if isinstance(chaser.turning, Held) else (COMMAND_DOUBTED,)


def told(doubted: Collection[str]) -> str:
    """Return what an operator is told about the doubts of a track; empty for none."""
    if COMMAND_DOUBTED in doubted:
        return _DOUBTED.format(*((_NO_GAP, _OR_TURNS) if CHASER_TURNS in doubted else (_BY_GYRO, "")))
    return _TURNS if doubted else ""


def imu_of(model: MotionModel | None) -> ImuTrack | None:
    """Return the readings of the IMU that a model of motion uses; None if it uses none."""
    model = model.measured if isinstance(model, Turning) else model
    chaser = model.chaser if isinstance(model, FreeMotion) else None
    chaser = chaser.turning if isinstance(chaser, Commanded) else chaser
    return chaser if isinstance(chaser, ImuTrack) else None


def relied_on(state: FilterState) -> str:
    """Return what the prediction of a state relies on beside the sensors, for an operator; empty for none.

    Where poses contradict it, this is told instead.
    """
    model = state.model
    if isinstance(model, Turning):  # poses have contradicted it
        return f"; {told(doubts(state))}"
    if not isinstance(model, FreeMotion):
        return ""
    chaser, parts = model.chaser, []
    if isinstance(chaser, Commanded):
        parts.append("guidance/command (axes, sign, stamps)")
        chaser = chaser.turning
    held = isinstance(chaser, Held)
    parts.append("a chaser that holds its attitude (dynamics.imu)" if held else _IMU)
    if model.inertia is not None:
        parts.append("a target without torque, with the inertia of its file (dynamics.target)")
    return f"; predictions rely on {', and on '.join(parts)}"


class Met(NamedTuple):
    """A pose, and how a track predicted it."""

    measured: PoseMeasurement
    innovation: Innovation
    """Innovation before the pose raised any factor."""
    config: FilterConfig


def chosen(
    before: FilterState,
    after: FilterState,
    met: Met,
    advance: Callable[[FilterState, FilterState], FilterState],
) -> FilterState:
    """Return the state after a pose: of the track, or of the filter beside it if poses favour that.

    Args:
        before: the state after the previous measurement.
        after: the state of the track after the pose, accepted or not.
        met: the pose.
        advance: gives the state of a filter after the pose, from its state before and its prediction.
    """
    other, stamp_ns = before.other or _beside(before), met.measured.stamp_ns
    if other is None:
        return after
    predicted = predict(other.state, stamp_ns, met.config)
    found = compared(predicted, met.measured, met.config)
    if not (np.isfinite(found.covariance).all() and np.isfinite(found.difference).all()):
        return replace(after, other=other)
    state = advance(other.state, predicted)
    odds = other.log_odds + log_density(found) - _of_track(before, met)
    limit = -_REFUSALS * log(max(chdtrc(after.alike.dof, gate_nis(after, met.config)), LEAST))
    wins = odds > limit
    if turns(before):
        wins = wins and stamp_ns - other.since_ns > HELD_S * NANOSECONDS
        if odds < -limit:  # the chaser does not hold its attitude yet
            return replace(after, other=None)
    else:
        odds = max(odds, 0.0)
    return replace(state, other=None) if wins else replace(after, other=Other(state, other.since_ns, odds))


def _beside(state: FilterState) -> Other | None:
    """Return the filter with the other assumption about the chaser at a state; None if there is none."""
    model = state.model
    state = replace(
        state, manoeuvre=CALM, lag=CALM, sums=(NO_INNOVATIONS, NO_INNOVATIONS), steady=None, other=None
    )
    if isinstance(model, Turning):
        return Other(grown(replace(state, model=model.held), model.blocks), state.stamp_ns)
    if not isinstance(model, FreeMotion) or not any(model.states_noise):
        return None
    if not isinstance(model.chaser, Held | Commanded):  # all that is assumed of the chaser is measured
        return None
    measured = _measured(model)
    left_out = STATES if measured is None else frozenset(FORCE_ERRORS)
    own = tuple(block for block in state.blocks if block.name in left_out)
    for block in own:
        state = state.without(block.name)
    return Other(replace(state, model=Turning(model, unknown(own), measured)), state.stamp_ns)


def _measured(model: FreeMotion) -> FreeMotion | None:
    """Return the model without the commands, if the chaser's rotation is measured; otherwise None."""
    chaser = model.chaser
    if not isinstance(chaser, Commanded) or isinstance(chaser.turning, Held):
        return None
    return replace(model, chaser=chaser.turning, uses_force=False, acceleration_density_m2_s3=None)


def _of_track(before: FilterState, met: Met) -> float:
    """Return the logarithm of the density of a pose by a track, or by the filter without its acceleration.

    After a refusal by chance, the accelerations of the track alone are raised for some poses.
    """
    density = log_density(met.innovation)
    if before.steady is None:
        return density
    steady = predict(before.steady.state, met.measured.stamp_ns, met.config)
    return max(density, log_density(compared(steady, met.measured, met.config)))
