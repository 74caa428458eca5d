"""Composition of a registration from the last iteration of a depth method: checks, cost and covariance."""

from dataclasses import dataclass, field, replace
from typing import NamedTuple, Protocol

from scipy.spatial.transform import RigidTransform

from rpod_pose.acceptance import accepted_by_residuals
from rpod_pose.belief import Belief, doubtful
from rpod_pose.pmd.depth_view import DepthImage
from rpod_pose.ports import Registration
from rpod_pose.registration.normal_equations import NormalEquations
from rpod_schemas.config.acceptance import AcceptanceConfig
from rpod_schemas.config.pmd.lengths import chosen, relative_size
from rpod_schemas.config.pmd.methods import DepthComparisonConfig, DepthErrorConfig
from rpod_schemas.types import Source
from rpod_target import Target


@dataclass(frozen=True, eq=False)
class Progress:
    """Result of a depth method's iterations."""

    T_sensor_target: RigidTransform
    sums: NormalEquations = field(default_factory=NormalEquations.none)
    """Normal equations of the last iteration."""
    points: int = 0
    """Number of points that could have matched."""
    step_m: float = float("inf")
    """Displacement of the target's surface by the last step."""
    iterations: int = 0
    reason: str = ""
    """Reason why the iterations were aborted; empty if they were not."""


class ResultConfig(Protocol):
    """The parameters of a depth method's checks."""

    @property
    def unsettled_m(self) -> float | None:
        """Largest last step of iterations that count as converged, m; None if it follows from the size."""
        ...

    @property
    def comparison(self) -> DepthComparisonConfig:
        """Parameters of the self-check."""
        ...

    @property
    def acceptance(self) -> AcceptanceConfig:
        """Limits within which the registration is accepted."""
        ...

    @property
    def errors(self) -> DepthErrorConfig:
        """Errors that the covariance assumes."""
        ...


class ResultLengths(NamedTuple):
    """Lengths of the checks of a depth method, m, and a limit of squares, m2."""

    unsettled_m: float
    """Motion in the last step above which the iterations did not converge."""
    tolerance_m: float
    """Largest difference of measured and rendered depth that agree."""
    max_cost_m2: float
    """Largest mean squared residual of the inliers."""

    @classmethod
    def of(cls, config: ResultConfig, size: float) -> "ResultLengths":
        """Return the lengths for what is seen of a size relative to the mock-up."""
        return cls(
            unsettled_m=chosen(config.unsettled_m, 0.02 * size),
            tolerance_m=chosen(config.comparison.tolerance_m, config.errors.tolerance_m(size)),
            max_cost_m2=chosen(config.acceptance.max_cost_m2, config.errors.max_cost_m2(size)),
        )


def size_of(target: Target, image: DepthImage) -> float:
    """Return the size of what an image shows of a target, relative to the mock-up."""
    return relative_size(target.radius_m, image.median_m)


def registration_of(
    progress: Progress, image: DepthImage, target: Target, config: ResultConfig
) -> Registration:
    """Return the registration with cost, covariance and self-check, or the reason why there is no pose."""
    sums, T = progress.sums.without_turn(target.equivalence.free_axes), progress.T_sensor_target
    reason, lengths = progress.reason, ResultLengths.of(config, size_of(target, image))
    if not reason and progress.step_m > lengths.unsettled_m:
        reason = (
            f"did not converge: the last of {progress.iterations} steps was {progress.step_m:.3f} m, "
            f"limit {lengths.unsettled_m:.3f} m"
        )
    if not reason and sums.degenerate(target.radius_m):
        reason = "degenerate: the matched surface does not determine the pose in all directions"
    registration = Registration(
        Source.PMD_DEPTH,
        belief=doubtful(reason) if reason else Belief(),
        cost_m2=sums.cost_m2,
        inliers=sums.inliers,
        inlier_share=sums.inliers / progress.points if progress.points else 0.0,
        iterations=progress.iterations,
    )
    if reason:
        return registration
    registered = replace(
        registration,
        T_sensor_target=T,
        explained_share=image.compare(
            target, T, tolerance_m=lengths.tolerance_m, missing_weight=config.comparison.missing_weight
        ).explained_share,
        covariance=sums.covariance(T, config.errors),
    )
    return accepted_by_residuals(registered, config.acceptance, max_cost_m2=lengths.max_cost_m2)
