"""A measured pose, and the errors that it shares with other measured poses.

Errors of successive frames are correlated: those of a sensor's mount, of its calibration, of the places of
edges on the pixels, of the target's model. If the configuration says so (``FilterConfig.errors``), they are
states of the filter, so that they do not average out. Mounts are estimated; the other errors are considered.

The method states three covariances of errors that last (``ports.ErrorParts``). Each such error is L b. L is
the symmetric root of its covariance in the axes to which the error is fixed, and b are six states of variance
1. The symmetric root is a continuous function of the covariance, so that b keeps its meaning from frame to
frame. The covariance in use is the average of those that the frames of one view state (``blocks.averaged``).
If a frame states a larger one, the difference is noise of this frame.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import inf, radians
from typing import NamedTuple, TypeVar

import numpy as np
from scipy.spatial.transform import RigidTransform

from rpod_pose.navigation.filter import (
    NOTHING,
    TWIST,
    Block,
    FilterState,
    Innovation,
    MotionModel,
    Sensitivities,
    Update,
    grown,
    innovation_of,
    start,
    update,
    velocity_sigma_m_s,
)
from rpod_pose.navigation.filter.blocks import Known, averaged, root_of, unknown, variances, with_known
from rpod_pose.navigation.filter.rotations import cross_matrix, symmetric
from rpod_pose.pose_evidence import ErrorParts
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.estimator.filter import FilterConfig
from rpod_schemas.poses import rotation_matrix
from rpod_target import NO_SYMMETRY, Equivalence

ResultT = TypeVar("ResultT")

MOUNT = "mount of {}"
"""Name of the block with the error of a sensor's mount: (dp, dtheta) of the stated mount, chaser axes."""
_BESIDE = "{} differs from the track"
"""Name of the block with the declared differences of a sensor from the track that another one began."""
_CALIBRATION, _IMAGE, _MODEL = "calibration of {}", "image of {}", "model as {} sees it"


@dataclass(frozen=True, eq=False)
class Origin:
    """Where a measured pose comes from."""

    sensor: str
    T_chaser_sensor: RigidTransform
    """Mount of the sensor, as stated."""
    parts: ErrorParts | None = None
    """The pose's errors by how long they last, sensor axes; None if the method does not separate them."""


@dataclass(frozen=True, eq=False)
class PoseMeasurement:
    """A pose measured at a time."""

    stamp_ns: int
    T_chaser_target: RigidTransform
    covariance: FloatArray
    """Covariance of (dp, dtheta), ICD section 1, shape (6, 6), without the error of the mount."""
    origin: Origin | None = None
    """Where it comes from; None for a pose that no sensor has measured, for example a given one."""
    alone: bool = False
    """Whether its frame alone, without the prediction, proves what it determines of the pose. If the gate
    refuses such a pose, larger accelerations are tried (``dynamics/manoeuvre``)."""
    since_s: float = inf
    """Time since the previous accepted frame of the same sensor, s; frames near in time have similar
    errors."""
    lasting_s: float = 0.0
    """RMS time between the returns and the stamp, s. An error of the twist that de-skewed the frame shifts
    the pose by about this error multiplied by this time."""
    declared: FloatArray | None = None
    """What one standard deviation of each declared difference from the track does to (dp, dtheta), shape
    (6, n), chaser axes; None for a sensor that began the track, and where mounts are states."""


class Shared(NamedTuple):
    """Errors of a measured pose: its own ones, and the states through which it shares errors with others."""

    covariance: FloatArray
    """Covariance of the errors that belong to no block, shape (6, 6)."""
    white: bool
    """Whether this covariance is that of noise alone. Otherwise it includes errors that last."""
    blocks: tuple[Block, ...]
    """The states on which the measured pose depends, with their initial values."""
    sensitivities: Sensitivities
    """Derivatives of the measured pose with respect to these states."""


def started(
    measured: PoseMeasurement,
    *,
    config: FilterConfig,
    centre_of_mass_m: FloatArray | None = None,
    alike: Equivalence = NO_SYMMETRY,
    blocks: Sequence[Block] = (),
    known: Known | None = None,
    model: MotionModel | None = None,
) -> FilterState:
    """Return the state after a first measured pose, with an unknown twist; arguments as for ``start``.

    ``known`` has blocks as a filter before knows them; None for none.
    """
    shared = shared_errors(measured, config, () if known is None else known.blocks)
    names = {block.name for block in blocks}
    chosen = (*blocks, *(block for block in shared.blocks if block.name not in names))
    merged = Known(chosen, np.diag(variances(chosen))) if known is None else with_known(chosen, known)
    velocity_m_s = velocity_sigma_m_s(measured.T_chaser_target, config)
    sigma = np.repeat([velocity_m_s, radians(config.initial_rate_sigma_deg_s)], 3)
    return start(
        measured.T_chaser_target,
        shared.covariance + measured.lasting_s**2 * np.diag(sigma**2),
        measured.stamp_ns,
        config=config,
        centre_of_mass_m=centre_of_mass_m,
        alike=alike,
        blocks=merged.blocks,
        of_blocks=merged.covariance,
        sensitivities=shared.sensitivities,
        white=shared.white,
        model=model,
    )


def updated(predicted: FilterState, measured: PoseMeasurement, config: FilterConfig) -> Update:
    """Return the update of a prediction with a measured pose of the same stamp.

    A rejected pose changes nothing, not even the blocks of the errors that its sensor's frames share.
    """
    found = _applied(update, predicted, measured, config)
    return found if found.accepted else found._replace(state=predicted)


def compared(predicted: FilterState, measured: PoseMeasurement, config: FilterConfig) -> Innovation:
    """Return the innovation of a measured pose against a prediction to its stamp."""
    return _applied(innovation_of, predicted, measured, config)


def _applied(
    step: Callable[..., ResultT], predicted: FilterState, measured: PoseMeasurement, config: FilterConfig
) -> ResultT:
    """Return the result of a step of the filter with a measured pose, its shared errors as blocks."""
    shared = shared_errors(measured, config, predicted.blocks)
    return step(
        grown(predicted, shared.blocks),
        measured.T_chaser_target,
        shared.covariance + measured.lasting_s**2 * predicted.covariance[TWIST, TWIST],
        config=config,
        sensitivities=shared.sensitivities,
        white=shared.white,
        since_s=measured.since_s,
    )


def shared_errors(measured: PoseMeasurement, config: FilterConfig, known: Sequence[Block] = ()) -> Shared:
    """Return the own errors of a measured pose, and the states of shared errors, chaser axes.

    Args:
        measured: the pose.
        config: how errors are treated.
        known: blocks of the state with which the pose is compared.
    """
    origin = measured.origin
    if origin is None:
        return Shared(measured.covariance, white=False, blocks=(), sensitivities=NOTHING)
    blocks: list[Block] = []
    by: dict[str, FloatArray] = {}
    if config.mount_sigma_deg or config.mount_sigma_m:
        mount = mount_of(origin.sensor, config)
        blocks.append(mount)
        by[mount.name] = _by_mount(measured.T_chaser_target, origin.T_chaser_sensor)
    if measured.declared is not None:
        size = measured.declared.shape[1]
        beside = Block(beside_of(origin.sensor), np.zeros(size), np.ones(size))
        blocks.append(beside)
        by[beside.name] = measured.declared
    if config.errors == "inflated" or origin.parts is None:
        return Shared(measured.covariance, white=False, blocks=tuple(blocks), sensitivities=by)
    parts, before = origin.parts, {block.name: block for block in known}
    to_chaser = _turn(rotation_matrix(origin.T_chaser_sensor))
    to_target = _turn(rotation_matrix(measured.T_chaser_target).T)
    noise = to_chaser @ parts.white @ to_chaser.T
    for kind, covariance, axes, turn_rad in (
        (_CALIBRATION, parts.of_sensor, np.eye(6), inf),
        (_IMAGE, parts.of_image, to_target @ to_chaser, parts.image_turn_rad),
        (_MODEL, parts.of_model, to_target @ to_chaser, radians(config.tuning.model_turn_deg)),
    ):
        if not covariance.any():
            continue
        name, stated = kind.format(origin.sensor), axes @ covariance @ axes.T
        new = Block(name, np.zeros(6), np.ones(6), turn_rad=turn_rad, considered=True, spread=stated)
        block = averaged(new, before.get(name))
        assert block.spread is not None  # noqa: S101 - given above
        back = to_chaser @ axes.T
        blocks.append(block)
        by[name] = back @ root_of(block.spread)
        more = back @ root_of(stated - block.spread)
        noise = noise + more @ more.T
    return Shared(symmetric(noise), white=True, blocks=tuple(blocks), sensitivities=by)


def is_of_sensor(block: str) -> bool:
    """Return whether a block of this name is of a sensor's mount or calibration, whatever is seen."""
    return block.startswith((MOUNT.format(""), _CALIBRATION.format("")))


def beside_of(sensor: str) -> str:
    """Return the name of the block with the declared differences of a sensor from another one's track."""
    return _BESIDE.format(sensor)


def alone_of(blocks: Sequence[Block]) -> tuple[Block, ...]:
    """Return blocks before any measurement, without those of differences from another sensor's track."""
    return unknown([block for block in blocks if not is_beside(block.name)])


def is_beside(block: str) -> bool:
    """Return whether a block of this name is of a sensor's differences from another one's track."""
    return block.endswith(_BESIDE.format(""))


def calibration_of(sensor: str) -> str:
    """Return the name of the block with the error of a sensor's calibration."""
    return _CALIBRATION.format(sensor)


def mount_of(sensor: str, config: FilterConfig) -> Block:
    """Return the block of the error of a sensor's mount at its initial value, zero."""
    sigma = np.repeat([config.mount_sigma_m, radians(config.mount_sigma_deg)], 3)
    return Block(MOUNT.format(sensor), np.zeros(6), sigma)


def _by_mount(T_chaser_target: RigidTransform, T_chaser_sensor: RigidTransform) -> FloatArray:
    """Return the derivatives of a measured pose with respect to the error of the mount, shape (6, 6).

    A displaced sensor displaces the measured target like a rigid body.
    """
    by = np.eye(6)
    by[:3, 3:] = -cross_matrix(T_chaser_target.translation - T_chaser_sensor.translation)
    return by


def _turn(R: FloatArray) -> FloatArray:
    turn = np.zeros((6, 6))
    turn[:3, :3] = turn[3:, 3:] = R
    return turn
