"""State of the filter at one time."""

from collections.abc import Collection
from dataclasses import dataclass, field, replace
from typing import NamedTuple, Protocol

import numpy as np
from scipy.spatial.transform import RigidTransform

from rpod_pose.navigation.filter.blocks import Block, Known, placed
from rpod_pose.navigation.filter.rotations import exponential, orthonormal
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.estimator.filter import FilterConfig
from rpod_schemas.poses import pose_of, rotation_matrix
from rpod_target import NO_SYMMETRY, Equivalence
from rpod_target.equivalence import with_variance_about

POSITION, ATTITUDE, VELOCITY, RATE = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)
"""Components of the error vector: (dp, dtheta, dv, dw)."""
POSE, TWIST = slice(0, 6), slice(6, 12)
"""Components of position with attitude, and of velocity with rate."""
MOTION = slice(0, 12)
"""Pose and twist; the states of blocks follow."""


class Motion(NamedTuple):
    """A state after a step, and the propagation of its errors: ``after`` (F e + noise)."""

    state: "FilterState"
    """State after the step, still with the covariance and the stamp of before."""
    F: FloatArray
    """Matrix that propagates the errors, before ``after`` is applied, shape (12 + n, 12 + n)."""
    noise: FloatArray
    """Covariance of the added noise, before ``after`` is applied, shape (12 + n, 12 + n)."""
    after: FloatArray | None
    """Matrix that multiplies errors and noise at the end, shape (12 + n, 12 + n); None for the identity."""


class MotionModel(Protocol):
    """A model of the motion of target and chaser."""

    @property
    def states_noise(self) -> tuple[bool, bool]:
        """Whether it states the noise of accelerations and of angular accelerations itself.

        Then no ``Manoeuvre`` raises it.
        """
        ...

    def __call__(self, state: "FilterState", step_s: float, config: FilterConfig) -> Motion:
        """Return the motion of a state in a step of ``step_s`` seconds."""
        ...


class Manoeuvre(NamedTuple):
    """Factors, at least 1, on the densities of accelerations while the target accelerates unexpectedly."""

    acceleration: float
    """Factor on ``acceleration_density_m2_s3``."""
    angular: float
    """Factor on ``angular_acceleration_density_rad2_s3``."""


CALM = Manoeuvre(1.0, 1.0)
"""Factors for a target that moves as the configuration expects."""


class InnovationSum(NamedTuple):
    """Weighted sum of the innovations of accepted poses, of position or attitude; older ones weigh less."""

    difference: FloatArray
    """Sum of the differences, m or rad, shape (3,)."""
    covariance: FloatArray
    """Covariance of ``difference`` if the innovations are independent, shape (3, 3)."""
    squares: float
    """Sum of the normalised squares of the innovations."""
    weights: float
    """Sum of the weights."""
    squared_weights: float
    """Sum of the squared weights, which are those of ``covariance`` and ``squares``."""
    shared: FloatArray | None = None
    """Its covariance with the errors of the states, shape (3, 12 + n); None where it is 0. It is 0 for the
    gain that leaves the least errors. A gain that leaves considered blocks alone is none."""

    def faded(self, keep: float) -> "InnovationSum":
        """Return the sum of which a share is left."""
        return InnovationSum(
            keep * self.difference,
            keep**2 * self.covariance,
            keep**2 * self.squares,
            keep * self.weights,
            keep**2 * self.squared_weights,
            None if self.shared is None else keep * self.shared,
        )

    def shared_with(self, size: int) -> FloatArray:
        """Return the covariance with the errors of as many states, (3, size); new ones share nothing."""
        found = np.zeros((3, size))
        if self.shared is not None:
            found[:, : self.shared.shape[1]] = self.shared
        return found

    def without(self, place: slice) -> "InnovationSum":
        """Return the sum without some of the states."""
        if self.shared is None:
            return self
        return self._replace(shared=np.delete(self.shared, place, axis=1))

    def moved(self, by: FloatArray) -> "InnovationSum":
        """Return the sum after a step in which the errors of the states are multiplied by a matrix."""
        return self if self.shared is None else self._replace(shared=self.shared_with(len(by)) @ by.T)


NO_INNOVATIONS = InnovationSum(np.zeros(3), np.zeros((3, 3)), 0.0, 0.0, 0.0)
"""The sum of none."""


@dataclass(frozen=True, eq=False)
class Steady:
    """A filter beside a track that is assumed to accelerate: the track if it does not."""

    state: "FilterState"
    """State after the last measurement that it has used."""
    since_ns: int
    """Stamp of the pose at which the two parted."""
    by_chance: float
    """Probability with which the gate refuses such a pose by chance; 0 if later poses have shown that the
    target had accelerated until ``since_ns``."""
    log_odds: float = 0.0
    """Log odds of the poses since ``since_ns`` between this filter and the track."""


@dataclass(frozen=True, eq=False)
class Other:
    """A filter beside a track, with another assumption about the chaser's attitude (``dynamics/slewing``)."""

    state: "FilterState"
    """State after the last measurement."""
    since_ns: int
    """Stamp at which it began beside the track."""
    log_odds: float = 0.0
    """Log odds of the poses between this filter and the track."""


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
    chaser_rate_variance: float = 0.0
    """Variance about each axis of the chaser's rate, relative to which velocity and rate are given,
    (rad/s)^2. Its error is not in the covariance, since the next prediction takes it out again."""
    manoeuvre: Manoeuvre = CALM
    """Factors by which the densities are raised after the gate refused a pose that its frame alone proves."""
    lag: Manoeuvre = CALM
    """Factors by which the densities are raised because the estimate lags behind the target."""
    sums: tuple[InnovationSum, InnovationSum] = (NO_INNOVATIONS, NO_INNOVATIONS)
    """Sums of the innovations of position and of attitude, in which a lag is detected."""
    steady: Steady | None = None
    """Filter without the acceleration that a refused pose may show; None while there was none."""
    other: Other | None = None
    """Filter with the other assumption about the chaser's attitude; None if there is none."""

    @property
    def size(self) -> int:
        """Number of states, 12 + n."""
        return len(self.covariance)

    @property
    def factors(self) -> Manoeuvre:
        """Factors by which the densities of accelerations are raised."""
        return Manoeuvre(*map(max, self.manoeuvre, self.lag))

    @property
    def may_be_raised(self) -> tuple[bool, bool]:
        """Whether ``factors`` raise the noise of accelerations and of angular accelerations."""
        of_linear, of_angular = (False, False) if self.model is None else self.model.states_noise
        return not of_linear, not of_angular

    def places(self) -> dict[str, slice]:
        """Return the slices of the blocks' states in the covariance, by the block's name."""
        return {block.name: place for block, place in placed(self.blocks, MOTION.stop)}

    def known_of(self, names: Collection[str]) -> Known:
        """Return the blocks with these names, and the covariance of their states together."""
        kept = [(block, place) for block, place in placed(self.blocks, MOTION.stop) if block.name in names]
        there = np.r_[tuple(place for _, place in kept)] if kept else np.zeros(0, int)
        return Known(tuple(block for block, _ in kept), self.covariance[np.ix_(there, there)])

    def without(self, name: str) -> "FilterState":
        """Return the state without the block of a name."""
        place = self.places()[name]
        return replace(
            self,
            covariance=np.delete(np.delete(self.covariance, place, axis=0), place, axis=1),
            blocks=tuple(block for block in self.blocks if block.name != name),
            sums=(self.sums[0].without(place), self.sums[1].without(place)),
        )

    def corrected(self, correction: FloatArray) -> "FilterState":
        """Return the state after a correction of its errors, shape (12 + n,), with the same covariance."""
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
    """Return a state without errors of the angles about free axes, and with unknown rates about them."""
    if not len(state.alike.free_axes):
        return state
    axes = state.alike.free_axes @ rotation_matrix(state.T_chaser_target).T
    sigma_rad_s = np.deg2rad(config.initial_rate_sigma_deg_s)
    covariance = with_variance_about(state.covariance, axes, 0.0, first=ATTITUDE.start)
    covariance = with_variance_about(covariance, axes, sigma_rad_s**2, first=RATE.start)
    rate_rad_s = state.rate_rad_s - axes.T @ (axes @ state.rate_rad_s)
    return replace(state, rate_rad_s=rate_rad_s, covariance=covariance)
