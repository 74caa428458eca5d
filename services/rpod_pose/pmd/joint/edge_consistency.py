"""What the edges of a PMD frame say of a pose that its depth agrees with: their places, and the scale."""

import math

from rpod_schemas.config.pmd_joint import JointVerdictConfig


def edges_in_place(
    limits: JointVerdictConfig, *, edges: int, expected: float, asked: int, points: int
) -> float:
    """Return the share of the edges in their place, and what chance may take off it.

    Between two faces there may be no change to see: where there is depth, so much is granted. It is 1 where
    too few are asked.

    Args:
        limits: what is too little to say anything.
        edges: places of edges where the pose has them.
        expected: of those that show a change, how many noise leaves there.
        asked: places that were looked at.
        points: with depth.
    """
    if asked < limits.min_edges:
        return 1.0
    changed_share = limits.min_changed_share if points >= limits.min_points else 1.0
    expected = max(expected, changed_share * asked, 1.0)
    return edges / expected + 1.0 / math.sqrt(expected)


def misplaced_edges(limits: JointVerdictConfig, in_place: float) -> str:
    """Return why the edges do not bear out a pose, empty if they do."""
    if in_place >= limits.min_edge_share:
        return ""
    return f"{in_place:.0%} of the edges are in their place, {limits.min_edge_share:.0%} needed"


def wrong_scale(limits: JointVerdictConfig, *, bias_m: float, sigma_m: float, range_m: float) -> str:
    """Return why ranges and edges are not of one target, empty if they may be.

    Edges tell how large the target looks, ranges how far off it is: one of another size, or in an image of
    another focal length, is not where it would look as large as it does.

    Args:
        limits: what is tolerated.
        bias_m: by which all ranges are too long for the edges, as the fit has it.
        sigma_m: of such a bias, that the camera has.
        range_m: of the target.
    """
    most_m = limits.bias_sigmas * sigma_m + limits.scale_share * range_m
    if abs(bias_m) <= most_m:
        return ""
    return f"ranges are {bias_m:+.3f} m off where edges have the target, {most_m:.3f} at most"
