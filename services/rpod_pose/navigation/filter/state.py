"""State of the filter at one time."""

from dataclasses import dataclass, field, replace
from typing import NamedTuple, Protocol

import numpy as np
from scipy.spatial.transform import RigidTransform

from rpod_pose.navigation.filter.blocks import Block, placed
from rpod_pose.navigation.filter.rotations import exponential, orthonormal
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.estimator.filter import FilterConfig
from rpod_schemas.poses import pose_of, rotation_matrix
from rpod_target import NO_SYMMETRY, Equivalence
from rpod_target.equivalence import with_variance_about

POSITION, ATTITUDE, VELOCITY, RATE = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)
"""Places of a state's parts among its errors."""
POSE, TWIST = slice(0, 6), slice(6, 12)
"""Places of position with attitude, and of velocity with rate."""
MOTION = slice(0, 12)
"""Pose and twist; the states of blocks follow."""


class Motion(NamedTuple):
    """A state after a step, and how its errors move in the step."""

    state: "FilterState"
    """State after the step, with the covariance and the stamp of before."""
    F: FloatArray
    """Derivatives of the errors by those before, but for ``after``, shape (12 + n, 12 + n)."""
    noise: FloatArray
    """Covariance of the noise that comes in addition, but for ``after``, shape (12 + n, 12 + n)."""
    after: FloatArray | None
    """Matrix that multiplies errors and noise at the end, shape (12 + n, 12 + n); None for nothing."""


class MotionModel(Protocol):
    """A model of the motion of target and chaser."""

    def __call__(self, state: "FilterState", step_s: float, config: FilterConfig) -> Motion:
        """Return the motion of a state in a step, s."""
        ...


class Manoeuvre(NamedTuple):
    """Factors on the densities of accelerations, at least 1, while the target moves by more than expected."""

    acceleration: float
    """Factor on ``acceleration_density_m2_s3``."""
    angular: float
    """Factor on ``angular_acceleration_density_rad2_s3``."""


CALM = Manoeuvre(1.0, 1.0)
"""The target moves as the configuration expects."""


class InnovationSum(NamedTuple):
    """Sum of the innovations of one part of accepted poses, in which older ones count less."""

    difference: FloatArray
    """Sum of the differences, shape (3,)."""
    covariance: FloatArray
    """Its covariance if the innovations are independent, shape (3, 3)."""
    squares: float
    """Sum of their normalised squares."""
    weights: float
    """Sum of the weights."""
    squared_weights: float
    """Sum of the squared weights, which are those of ``covariance`` and ``squares``."""


NO_INNOVATIONS = InnovationSum(np.zeros(3), np.zeros((3, 3)), 0.0, 0.0, 0.0)
"""The sum of none."""


@dataclass(frozen=True, eq=False)
class FilterState:
    """State of the filter at one time."""

    stamp_ns: int
    T_chaser_target: RigidTransform
    velocity_m_s: FloatArray
    """dp/dt of the target's origin, chaser axes, shape (3,)."""
    rate_rad_s: FloatArray
    """Rate of the target relative to the chaser, chaser axes, shape (3,)."""
    covariance: FloatArray
    """Covariance of (dp, dtheta, dv, dw), chaser axes, and of the n states of the blocks, in their order,
    shape (12 + n, 12 + n)."""
    centre_of_mass_m: FloatArray = field(default_factory=lambda: np.zeros(3))
    """Centre of mass r of the target, target axes, shape (3,)."""
    alike: Equivalence = NO_SYMMETRY
    """Attitudes that no measurement distinguishes."""
    blocks: tuple[Block, ...] = ()
    """Further states; their names differ."""
    model: MotionModel | None = None
    """Model of the motion between measurements; None for constant velocity and rate."""
    manoeuvre: Manoeuvre = CALM
    """Factors by which the densities are raised since the gate has refused a pose that its frame proves."""
    lag: Manoeuvre = CALM
    """Factors by which they are raised because the estimate lags behind the target."""
    sums: tuple[InnovationSum, InnovationSum] = (NO_INNOVATIONS, NO_INNOVATIONS)
    """The sums of position and attitude, which show whether it does."""

    @property
    def size(self) -> int:
        """Number of states, 12 + n."""
        return len(self.covariance)

    @property
    def factors(self) -> Manoeuvre:
        """Factors by which the densities of accelerations are raised."""
        return Manoeuvre(*map(max, self.manoeuvre, self.lag))

    def places(self) -> dict[str, slice]:
        """Return the places of the blocks' states in the covariance, by the block's name."""
        return {block.name: place for block, place in placed(self.blocks, MOTION.stop)}

    def corrected(self, correction: FloatArray) -> "FilterState":
        """Return the state moved by a correction of its errors, shape (12 + n,); its covariance is kept."""
        pose = self.T_chaser_target
        R = exponential(correction[ATTITUDE]) @ rotation_matrix(pose)
        return replace(
            self,
            T_chaser_target=pose_of(orthonormal(R), pose.translation + correction[POSITION]),
            velocity_m_s=self.velocity_m_s + correction[VELOCITY],
            rate_rad_s=self.rate_rad_s + correction[RATE],
            blocks=tuple(
                block if block.considered else replace(block, value=block.value + correction[place])
                for block, place in placed(self.blocks, MOTION.stop)
            ),
        )


def with_free_axes_unobserved(state: FilterState, config: FilterConfig) -> FilterState:
    """Return a state with no error of the angles about free axes, and with unknown rates about them."""
    if not len(state.alike.free_axes):
        return state
    axes = state.alike.free_axes @ rotation_matrix(state.T_chaser_target).T
    sigma_rad_s = np.deg2rad(config.initial_rate_sigma_deg_s)
    covariance = with_variance_about(state.covariance, axes, 0.0, first=ATTITUDE.start)
    covariance = with_variance_about(covariance, axes, sigma_rad_s**2, first=RATE.start)
    rate_rad_s = state.rate_rad_s - axes.T @ (axes @ state.rate_rad_s)
    return replace(state, rate_rad_s=rate_rad_s, covariance=covariance)
