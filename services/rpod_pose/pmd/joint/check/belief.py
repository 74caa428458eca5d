"""The belief in a pose by one frame of a PMD camera: by its pixels, its edges and its scale."""

import math

from rpod_pose.belief import Belief, contradicted, doubtful
from rpod_pose.pmd.joint.check.frame_check import Contradictions
from rpod_pose.pmd.joint.fit import EdgeEvidence
from rpod_pose.ports import PartSolution
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.pmd.joint import JointAcceptanceConfig, JointTuning
from rpod_schemas.types import Source


def frame_belief(
    tuning: JointTuning,
    inconsistent: Contradictions,
    in_place: float,
    *,
    bias_m: float,
    sigma_m: float,
    range_m: float,
) -> Belief:
    """Return the belief in a pose, with its evidence.

    Args:
        tuning: limits.
        inconsistent: pixels that are inconsistent with the pose.
        in_place: share of the expected edges that are near their place.
        bias_m: length by which all ranges are too long for the edges, as fitted.
        sigma_m: standard deviation of the camera's bias.
        range_m: distance of the target.
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
        inconsistent.reason(tuning.check) or misplaced_edges(limits, in_place) or wrong_scale(limits, **scale)
    )
    if reason:
        return contradicted(reason, **evidence)
    if in_place < limits.weak_edge_share:
        return doubtful(f"only {in_place:.0%} of the edges are in their place", **evidence)
    return Belief(evidence=evidence)


def edges_in_place(limits: JointAcceptanceConfig, found: EdgeEvidence) -> float:
    """Return the share of the expected edges found near their place, plus an allowance for chance.

    Each edge counts by the information that a missing one would be, -ln(1 - p) with p the probability of
    finding it at the right pose. One that the image may hide in any case proves little. The result is 1 if
    too few places are checked, or if no edge is expected.

    Args:
        limits: least numbers and shares that are conclusive.
        found: the edges.
    """
    weighed, expected, squares = found.in_place
    if found.checked < limits.min_edges or expected == 0.0:
        return 1.0
    return float((weighed + math.sqrt(squares)) / expected)


def source_of(limits: JointAcceptanceConfig, *, points: int, edges: int) -> Source:
    """Return the images by which a pose is measured, by its numbers of points and of places of edges."""
    if edges < limits.min_edges:
        return Source.PMD_DEPTH
    return Source.PMD_JOINT if points >= limits.min_points else Source.PMD_AMPLITUDE


def misplaced_edges(limits: JointAcceptanceConfig, in_place: float) -> str:
    """Return why the edges are inconsistent with a pose; empty if they are not."""
    if in_place >= limits.min_edge_share:
        return ""
    return f"{in_place:.0%} of the edges are in their place, {limits.min_edge_share:.0%} needed"


def bias_sigmas(limits: JointAcceptanceConfig, *, bias_m: float, sigma_m: float, range_m: float) -> float:
    """Return the bias of the ranges beyond that of ``scale_share``, in standard deviations of the camera's.

    Args:
        limits: tolerances.
        bias_m: length by which all ranges are too long for the edges, as fitted.
        sigma_m: standard deviation of the camera's bias.
        range_m: distance of the target.
    """
    return max(abs(bias_m) - limits.scale_share * range_m, 0.0) / sigma_m


def wrong_scale(limits: JointAcceptanceConfig, *, bias_m: float, sigma_m: float, range_m: float) -> str:
    """Return why ranges and edges cannot belong to one target; empty if they can.

    Edges show the apparent size of the target, ranges its distance. The two are inconsistent for a target of
    another size, or in an image with another focal length.

    Args:
        limits: tolerances.
        bias_m: as for ``bias_sigmas``.
        sigma_m: as for ``bias_sigmas``.
        range_m: as for ``bias_sigmas``.
    """
    if bias_sigmas(limits, bias_m=bias_m, sigma_m=sigma_m, range_m=range_m) <= limits.bias_sigmas:
        return ""
    most_m = limits.bias_sigmas * sigma_m + limits.scale_share * range_m
    return f"ranges are {bias_m:+.3f} m off the distance that the edges give, {most_m:.3f} m at most"


def by_distances(t: FloatArray, bias_m: float, sigma_m: float, scale: float) -> PartSolution:
    """Return the position by the measured distances alone, without the size that the edges show.

    Edges tell the distance by the size of the target as its model has it. A model of another size is seen in
    the fitted bias of the distances only.

    Args:
        t: position of the target in the sensor, shape (3,), m.
        bias_m: as for ``bias_sigmas``.
        sigma_m: as for ``bias_sigmas``.
        scale: standard deviation of the target's size, as a share, that its file declares.
    """
    range_m = math.hypot(*t)
    return PartSolution(
        "measured distances alone", bias_m * t / range_m, math.hypot(sigma_m, scale * range_m)
    )
