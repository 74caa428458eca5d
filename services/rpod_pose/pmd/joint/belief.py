"""The belief in a pose by one frame of a PMD camera: by its pixels, its edges and its scale."""

from rpod_pose.belief import Belief, contradicted, doubtful
from rpod_pose.pmd.frame_check import Contradictions
from rpod_pose.pmd.joint.edge_consistency import bias_sigmas, misplaced_edges, wrong_scale
from rpod_schemas.config.pmd.joint import JointTuning


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
