"""The belief in a pose from one frame of a PMD camera: from its pixels, its edges and its scale."""

import math

from rpod_pose.belief import Belief, contradicted, doubtful
from rpod_pose.pmd.joint.check.frame_check import Contradictions
from rpod_pose.pmd.joint.edge_points import EdgeEvidence
from rpod_pose.pmd.joint.uncertainty import BiasErrors
from rpod_pose.pose_evidence import PartSolution
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.pmd.joint import JointAcceptanceConfig, JointTuning
from rpod_schemas.types import Source

REMEDY = "check the albedo that the target's file states for the materials of its dark and bright parts"
"""What a user can do if a right pose is doubtful: the file tells which edges an image shows."""


def frame_belief(
    tuning: JointTuning,
    inconsistent: Contradictions,
    in_place: float,
    *,
    bias_m: float,
    sigma_m: float,
    range_m: float,
    far_off: str = "",
) -> Belief:
    """Return the belief in a pose, with its evidence.

    Args:
        tuning: limits.
        inconsistent: pixels that are inconsistent with the pose.
        in_place: share of the expected edges that are near their place.
        bias_m: fitted length by which all ranges are longer than the edges require.
        sigma_m: standard deviation of the camera's bias.
        range_m: distance of the target.
        far_off: why noisy ranges contradict a pose by the edges alone; empty if they do not.
    """
    limits = tuning.acceptance
    scale = {"bias_m": bias_m, "sigma_m": sigma_m, "range_m": range_m}
    evidence = {
        **inconsistent.evidence,
        "edges_in_place_share": in_place,
        "range_bias_m": bias_m,
        "range_bias_sigmas": bias_sigmas(limits, **scale),
    }
    reason = (
        inconsistent.reason(tuning.check)
        or misplaced_edges(limits, in_place)
        or wrong_scale(limits, **scale)
        or far_off
    )
    if reason:
        return contradicted(reason, **evidence)
    if in_place < limits.weak_edge_share:
        found = f"only {in_place:.0%} of the edges are in their place"
        return doubtful(f"{found}, {limits.weak_edge_share:.0%} needed for a sure pose: {REMEDY}", **evidence)
    return Belief(evidence=evidence)


def edges_in_place(limits: JointAcceptanceConfig, found: EdgeEvidence) -> float:
    """Return the share of the expected edges found near their place, plus an allowance for chance.

    Each edge has the weight -ln(1 - p), where p is the probability of finding it at the right pose. This is
    the information that its absence would give: an edge that the image often does not show proves little.
    The result is 1 if too few places are checked, or if no edge is expected.

    Args:
        limits: least number of checked places.
        found: statistics of the edges.
    """
    weighed, expected, squares = found.in_place
    if found.checked < limits.min_edges or expected == 0.0:
        return 1.0
    return float((weighed + math.sqrt(squares)) / expected)


def source_of(limits: JointAcceptanceConfig, *, points: int, edges: int) -> Source:
    """Return which images measure a pose, from its numbers of points and of checked places of edges."""
    if edges < limits.min_edges:
        return Source.PMD_DEPTH
    return Source.PMD_JOINT if points >= limits.min_points else Source.PMD_AMPLITUDE


def misplaced_edges(limits: JointAcceptanceConfig, in_place: float) -> str:
    """Return why the edges are inconsistent with a pose; empty if they are not."""
    if in_place >= limits.min_edge_share:
        return ""
    return f"{in_place:.0%} of the edges are in their place, {limits.min_edge_share:.0%} needed"


def bias_sigmas(limits: JointAcceptanceConfig, *, bias_m: float, sigma_m: float, range_m: float) -> float:
    """Return the bias of the ranges beyond the tolerance of ``scale_share``, in standard deviations.

    Args:
        limits: tolerances.
        bias_m: fitted length by which all ranges are longer than the edges require.
        sigma_m: standard deviation of the camera's bias.
        range_m: distance of the target.
    """
    return max(abs(bias_m) - limits.scale_share * range_m, 0.0) / sigma_m


def wrong_scale(limits: JointAcceptanceConfig, *, bias_m: float, sigma_m: float, range_m: float) -> str:
    """Return why ranges and edges cannot belong to one target; empty if they can.

    Edges show the apparent size of the target, and ranges its distance. The two are inconsistent if the
    target has another size than its model, or if the focal length is wrong.

    Args:
        limits: tolerances.
        bias_m: as for ``bias_sigmas``.
        sigma_m: as for ``bias_sigmas``.
        range_m: as for ``bias_sigmas``.
    """
    if bias_sigmas(limits, bias_m=bias_m, sigma_m=sigma_m, range_m=range_m) <= limits.bias_sigmas:
        return ""
    most_m = limits.bias_sigmas * sigma_m + limits.scale_share * range_m
    return f"ranges differ by {bias_m:+.3f} m from the distance that the edges give, limit {most_m:.3f} m"


def by_distances(
    t: FloatArray, bias_m: float, known: BiasErrors, scale: float, *, measured: bool
) -> PartSolution:
    """Return the position measured by the distances alone, without the apparent size that the edges show.

    Edges give the distance only if the model has the right size. If the size is wrong, only the fitted bias
    of the distances shows it.

    Args:
        t: position of the target, sensor axes, shape (3,), m.
        bias_m: as for ``bias_sigmas``.
        known: how well the bias is known.
        scale: relative standard deviation of the target's size, which its file declares.
        measured: whether there are enough points; without them the distances check nothing.
    """
    range_m = math.hypot(*t)
    if not measured:
        known = BiasErrors(math.inf, math.inf, known.follows)
    return PartSolution(
        "measured distances alone",
        bias_m * t / range_m,
        math.hypot(known.prior_m, scale * range_m),
        known.fitted_m,
        known.follows,
    )
