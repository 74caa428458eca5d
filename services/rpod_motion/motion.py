"""The relative motion of chaser and target as a function of time only."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_motion.attitude import FixedAttitude, Spin, Sway, TargetAttitude, integrate_tumble
from rpod_motion.errors import MotionError
from rpod_motion.trajectories.approach import Approach
from rpod_motion.trajectories.relative_orbit import cross
from rpod_motion.trajectories.station_keeping import StationKeeping
from rpod_motion.trajectories.synchronised import Slewing, Synchronised
from rpod_motion.trajectories.trajectory import Trajectory
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.motion import (
    ApproachConfig,
    AttitudeConfig,
    FixedAttitudeConfig,
    JointMotionConfig,
    MotionConfig,
    SlewConfig,
    SpinConfig,
    SunConfig,
    SwayConfig,
    TrajectoryConfig,
)
from rpod_schemas.poses import pose_of

MARGIN_S = 1.0
"""Time before the epoch and after the end for which the motion is defined, because exposures extend there."""


@dataclass(frozen=True, eq=False, slots=True)
class MotionState:
    """Pose and twist of the target relative to the chaser (ICD section 1)."""

    T_chaser_target: RigidTransform
    linear_m_s: FloatArray
    """Velocity of the target's origin, R^T dp/dt, target axes, shape (3,)."""
    angular_rad_s: FloatArray
    """Rotation rate relative to the chaser, vee(R^T dR/dt), target axes, shape (3,)."""
    chaser_angular_rad_s: FloatArray
    """Rotation rate of the chaser relative to inertial space, chaser axes, shape (3,)."""
    R_epoch_chaser: FloatArray
    """Attitude of the chaser in the epoch axes, shape (3, 3)."""
    R_orbit_chaser: FloatArray | None
    """Attitude of the chaser in the orbital frame, shape (3, 3); None for a trajectory without an orbit."""


@dataclass(frozen=True, eq=False)
class Motion:
    """The truth over time; ``build_motion`` creates it."""

    trajectory: Trajectory
    attitude: TargetAttitude
    sun_E_W_m2: FloatArray
    """Unit vector to the sun times its irradiance, epoch axes, shape (3,); zero for darkness."""
    duration_s: float
    joints: Mapping[str, JointMotionConfig] = field(default_factory=dict)
    """Motion of the target's joints, by name."""

    def state(self, time_s: float) -> MotionState:
        """Return pose and twist at a time from the epoch, -1 s to 1 s beyond the duration.

        The trajectory moves the target's anchor c, its origin or its centre of mass; the origin follows
        from the attitude: p = p_c - R c, so that R^T dp/dt = R^T dp_c/dt - omega x c.

        Raises:
            MotionError: the time lies outside this range.
        """
        self._require_inside(time_s)
        chaser = self.trajectory.state(time_s)
        R_chaser_target, angular_rad_s = self.attitude.relative(time_s, chaser)
        anchor_m = self.trajectory.anchor_m
        return MotionState(
            T_chaser_target=pose_of(R_chaser_target, chaser.position_m - R_chaser_target @ anchor_m),
            linear_m_s=R_chaser_target.T @ chaser.velocity_m_s - cross(angular_rad_s, anchor_m),
            angular_rad_s=angular_rad_s,
            chaser_angular_rad_s=chaser.chaser_angular_rad_s,
            R_epoch_chaser=chaser.R_epoch_chaser,
            R_orbit_chaser=chaser.R_orbit_chaser,
        )

    def sun_W_m2(self, time_s: float) -> FloatArray:  # noqa: N802 - watt
        """Return unit vector to the sun times irradiance, chaser axes, shape (3,); zero for darkness."""
        self._require_inside(time_s)
        return self.trajectory.state(time_s).R_epoch_chaser.T @ self.sun_E_W_m2

    def _require_inside(self, time_s: float) -> None:
        if not -MARGIN_S <= time_s <= self.duration_s + MARGIN_S:
            raise MotionError(
                f"{time_s:g} s lies outside the motion, {-MARGIN_S:g} to {self.duration_s + MARGIN_S:g} s"
            )


def build_motion(
    config: MotionConfig, *, centre_of_mass_m: FloatArray, inertia_kg_m2: FloatArray, duration_s: float
) -> Motion:
    """Build the motion of a target over a duration.

    Args:
        config: trajectory, attitude, sun.
        centre_of_mass_m: centre of mass, target axes, shape (3,).
        inertia_kg_m2: inertia about the centre of mass, target axes, shape (3, 3); used by a tumbling target.
        duration_s: time from the epoch to the end.

    Raises:
        MotionError: the duration is not positive, the inertia is not that of a rigid body, or an approach is
            synchronised with a target that does not turn, or the chaser slews and the target turns with it.
    """
    if not (np.isfinite(duration_s) and duration_s > 0.0):
        raise MotionError(f"the duration is {duration_s:g} s; it must be positive")
    attitude = _attitude(config.attitude, inertia_kg_m2, duration_s)
    trajectory = _trajectory(config.trajectory, centre_of_mass_m, duration_s)
    if isinstance(config.trajectory, ApproachConfig) and config.trajectory.synchronised:
        if isinstance(config.attitude, FixedAttitudeConfig | SwayConfig):
            raise MotionError(
                "synchronised needs an attitude that is not relative to the chaser "
                f"({config.attitude.kind} is): choose spin or tumble"
            )
        trajectory = Synchronised(trajectory, attitude)
    if config.slew is not None:
        trajectory = _slewing(config.slew, config.attitude, trajectory)
    return Motion(
        trajectory=trajectory,
        attitude=attitude,
        sun_E_W_m2=_sun(config.sun),
        duration_s=duration_s,
        joints=config.joints,
    )


def _trajectory(config: TrajectoryConfig, centre_of_mass_m: FloatArray, duration_s: float) -> Trajectory:
    if isinstance(config, ApproachConfig):
        return Approach(config.start_m, config.end_m, duration_s, config.ramp_share)
    return StationKeeping.on_safety_ellipse(
        centre_of_mass_m,
        least_range_m=config.least_range_m,
        greatest_range_m=config.greatest_range_m,
        phase_rad=np.deg2rad(config.phase_deg).item(),
        semi_major_axis_m=config.semi_major_axis_m,
        inclination_rad=np.deg2rad(config.inclination_deg).item(),
    )


def _attitude(config: AttitudeConfig, inertia_kg_m2: FloatArray, duration_s: float) -> TargetAttitude:
    rotation: Rotation = config.R_chaser_target
    if isinstance(config, FixedAttitudeConfig):
        return FixedAttitude(rotation.as_matrix())
    if isinstance(config, SpinConfig):
        return Spin(rotation.as_matrix(), _unit(config.axis), np.deg2rad(config.rate_deg_s).item())
    if isinstance(config, SwayConfig):
        return Sway(rotation.as_matrix(), np.deg2rad(config.amplitude_deg), config.period_s)
    return integrate_tumble(
        quaternion_xyzw=rotation.as_quat(),
        rate_rad_s=np.deg2rad(config.rate_deg_s),
        inertia_kg_m2=inertia_kg_m2,
        span_s=(-MARGIN_S, duration_s + MARGIN_S),
    )


def _slewing(config: SlewConfig, attitude: AttitudeConfig, path: Trajectory) -> Slewing:
    if isinstance(attitude, FixedAttitudeConfig | SwayConfig):
        raise MotionError(
            f"slew has no effect where the attitude is relative to the chaser ({attitude.kind}); choose spin "
            "or tumble"
        )
    amplitude_rad = np.deg2rad(config.amplitude_deg).item()
    return Slewing(path, _unit(config.axis), amplitude_rad, config.period_s)


def _sun(config: SunConfig | None) -> FloatArray:
    return np.zeros(3) if config is None else config.irradiance_W_m2 * _unit(config.direction)


def _unit(vector: FloatArray) -> FloatArray:
    return vector / np.linalg.norm(vector)
