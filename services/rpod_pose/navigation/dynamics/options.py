"""Creation of the model of motion, with its further states, from the configuration."""

from dataclasses import dataclass, replace
from math import pi, radians

import numpy as np

from rpod_pose.navigation.dynamics.chaser import Chaser, Held
from rpod_pose.navigation.dynamics.command_track import ERRORS, Commanded, CommandTrack
from rpod_pose.navigation.dynamics.free_motion import (
    ACCELERATION_BIAS,
    CENTRE_OF_MASS,
    GYRO_BIAS,
    INERTIA,
    STATES,
    THRUST_ERRORS,
    FreeMotion,
)
from rpod_pose.navigation.dynamics.imu_track import ImuTrack
from rpod_pose.navigation.dynamics.slewing import doubts, imu_of
from rpod_pose.navigation.dynamics.torque_free import RATIOS, Inertia
from rpod_pose.navigation.filter import CALM, Block, FilterState, MotionModel
from rpod_schemas.config.estimator.dynamics import DynamicsConfig
from rpod_schemas.errors import ConfigurationError
from rpod_target import Equivalence, Target


@dataclass(frozen=True, eq=False)
class Dynamics:
    """Prediction of tracks: the model of motion, and the initial values of its further states."""

    model: MotionModel | None = None
    """Model of the motion; None for constant velocity and rate as seen from the chaser."""
    blocks: tuple[Block, ...] = ()
    """Further states of the model."""
    imu: ImuTrack | None = None
    """Readings of the chaser's IMU, for a model that uses them."""
    commands: CommandTrack | None = None
    """Commanded accelerations of the chaser, for a model that uses them."""
    assumption: str = ""
    """Assumption about the chaser's motion that is made without an IMU, with the remedy; empty if none."""

    def blocks_at(self, stamp_ns: int) -> tuple[Block, ...]:
        """Return the further states of a track that begins at a stamp."""
        if self.imu is None:
            return self.blocks
        sigma = np.full(3, np.sqrt(self.imu.bias_at(stamp_ns).variance))
        return tuple(
            replace(block, sigma=sigma) if block.name == GYRO_BIAS else block for block in self.blocks
        )

    @classmethod
    def of(cls, config: DynamicsConfig, target: Target) -> "Dynamics":
        """Return the dynamics of a configuration and a target.

        Raises:
            ConfigurationError: torque-free rotation is configured for a target with a free axis, about which
                the rate is not observable.
        """
        return cls() if config.is_default else _free(config, target)


CONSTANT = Dynamics()
"""Constant velocity and rate as seen from the chaser."""


def evidence_of(state: FilterState) -> dict[str, float]:
    """Return norm and largest standard deviation of each block of further states, by name, for the status.

    If the target moves more than the filter expects, the factors on the densities of accelerations are
    included. ``CHASER_TURNS`` is 1 while the chaser turns although a held attitude was assumed, and
    ``COMMAND_DOUBTED`` is 1 while commanded accelerations are not used because poses contradict them.
    """
    places, found = state.places(), dict.fromkeys(doubts(state), 1.0)
    if (factors := state.factors) != CALM:
        found["acceleration_factor"] = factors.acceleration
        found["angular_acceleration_factor"] = factors.angular
    imu = imu_of(state.model)
    for block in state.blocks:
        if block.name in STATES:
            variances, value = np.diag(state.covariance)[places[block.name]], block.value
            if block.name == GYRO_BIAS and imu is not None:
                value = value + imu.bias_at(state.stamp_ns).bias_rad_s
            found[block.name] = float(np.linalg.norm(value))
            found[f"{block.name}_sigma"] = float(np.sqrt(variances.max()))
    return found


def _free(config: DynamicsConfig, target: Target) -> Dynamics:
    tuning = config.tuning
    _require_observable(config, target.equivalence)
    rate_rad_s = None if config.orbit is None else 2.0 * pi / config.orbit.period_s
    attitude = None if config.orbit is None else config.orbit.R_orbit_chaser
    R_orbit_chaser = None if attitude is None else attitude.as_matrix()
    imu, chaser = None, Held(R_orbit_chaser, rate_rad_s or 0.0)
    blocks = []
    if config.centre_of_mass_sigma_m:
        blocks.append(_block(CENTRE_OF_MASS, 3, config.centre_of_mass_sigma_m))
    torque_free = config.target == "torque_free"
    if torque_free and config.inertia_sigma:
        blocks.append(_block(INERTIA, RATIOS, config.inertia_sigma))
    if config.imu is not None:
        bias_sigma = radians(config.imu.gyro_bias_sigma_deg_s)
        imu = ImuTrack(
            radians(tuning.gyro_noise_deg_sqrt_s),
            R_orbit_chaser,
            force_noise_m_s_sqrt_s=tuning.accelerometer_noise_m_s_sqrt_s,
            orbit_rate_rad_s=rate_rad_s,
            bias_sigma_rad_s=bias_sigma,
            bias_walk_rad_s_sqrt_s=radians(tuning.gyro_bias_walk_deg_s_sqrt_s),
        )
        blocks.append(_block(GYRO_BIAS, 3, bias_sigma))
        if config.imu.acceleration_bias_sigma_m_s2 is not None:
            blocks.append(_block(ACCELERATION_BIAS, 3, config.imu.acceleration_bias_sigma_m_s2))
    moving: Chaser = chaser if imu is None else imu
    commands = None
    if config.command is not None:
        commands = CommandTrack()
        moving = Commanded(moving, commands, config.command.tuning)
        blocks.append(_block(THRUST_ERRORS, ERRORS, 1.0))
    uses_force = config.command is not None or config.uses_accelerometer
    model = FreeMotion(
        moving,
        inertia=Inertia(target.inertia_kg_m2) if torque_free else None,
        orbit_rate_rad_s=rate_rad_s,
        uses_force=uses_force,
        acceleration_density_m2_s3=(
            tuning.acceleration_density_m2_s3 if uses_force or config.orbit is not None else None
        ),
        angular_acceleration_density_rad2_s3=(
            tuning.angular_acceleration_density_rad2_s3 if torque_free else None
        ),
    )
    return Dynamics(model, tuple(blocks), imu, commands, _assumption(config))


def _assumption(config: DynamicsConfig) -> str:
    """Return what is assumed of the chaser's rotation without an IMU, with the remedy."""
    if config.imu is not None:
        return ""
    held = "in the orbital frame" if config.orbit is not None else "in inertial space"
    return (
        f"dynamics: the chaser is assumed to hold its attitude {held}; if it turns, the track goes on at a "
        "constant rate and bridges no gap: set dynamics.imu"
    )


def _block(name: str, size: int, sigma: float) -> Block:
    return Block(name, np.zeros(size), np.full(size, sigma))


def _require_observable(config: DynamicsConfig, alike: Equivalence) -> None:
    if config.target == "torque_free" and len(alike.free_axes):
        raise ConfigurationError(
            "estimator",
            "dynamics.target",
            "torque_free needs the rate about every axis, but the target has a free axis, and no measurement "
            "observes the rate about it; use constant_rate",
        )
