import numpy as np
import pytest
from pydantic import ValidationError

from rpod_pose.pmd.joint.check.belief import edges_in_place, frame_belief, misplaced_edges, wrong_scale
from rpod_pose.pmd.joint.check.frame_check import Contradictions
from rpod_pose.pmd.joint.edge_points import EdgeEvidence, EdgeSums
from rpod_pose.registration.normal_equations import no_sums
from rpod_schemas.config.pmd.joint import JointAcceptanceConfig, JointTuning
from rpod_schemas.types import BeliefLevel

LIMITS = JointAcceptanceConfig(
    min_edge_share=0.5, min_points=40, min_edges=40, bias_sigmas=2.0, scale_share=0.004
)


@pytest.mark.parametrize(
    ("checked", "in_place", "share"),
    [
        (120, (75.0, 100.0, 100.0), 0.85),
        (120, (150.0, 200.0, 400.0), 0.85),
        (40, (0.0, 0.0, 0.0), 1.0),
        (39, (0.0, 90.0, 90.0), 1.0),
    ],
    ids=["of what is expected", "whatever the weights", "nothing is expected", "too few"],
)
def test_the_share_of_edges_in_place_grants_what_chance_may_take_off(checked, in_place, share):
    shifts = EdgeSums(no_sums(), 0.0, 0.0, no_sums(), no_sums(), 0.0)
    evidence = EdgeEvidence(0.0, 0, checked, 0, 0.0, np.array(in_place), 0, 0.0, shifts)
    assert edges_in_place(LIMITS, evidence) == pytest.approx(share)


def test_misplaced_edges_are_a_reason_with_figures():
    assert misplaced_edges(LIMITS, 0.5) == ""
    assert misplaced_edges(LIMITS, 0.41) == "41% of the edges are in their place, 50% needed"


def test_a_pose_with_too_few_edges_names_the_albedo_that_a_user_may_correct():
    nothing = Contradictions(pixels=500, inconsistent=0, most_in_patch=0, most_missing=0)
    belief = frame_belief(JointTuning(), nothing, 0.66, bias_m=0.0, sigma_m=0.02, range_m=3.0)
    assert belief.level is BeliefLevel.DOUBTFUL
    assert belief.reason.startswith("only 66% of the edges are in their place, 70% needed for a sure pose: ")
    assert "albedo" in belief.reason


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_ranges_that_do_not_fit_the_size_are_a_reason_and_farther_off_more_is_tolerated(sign):
    assert wrong_scale(LIMITS, bias_m=sign * 0.059, sigma_m=0.025, range_m=2.5) == ""
    assert "0.061 m from the distance that the edges give, limit 0.060 m" in wrong_scale(
        LIMITS, bias_m=sign * 0.061, sigma_m=0.025, range_m=2.5
    )
    assert wrong_scale(LIMITS, bias_m=sign * 0.061, sigma_m=0.025, range_m=5.0) == ""


def test_what_is_not_believed_is_weak():
    with pytest.raises(ValidationError, match="weak_edge_share"):
        JointTuning(acceptance=JointAcceptanceConfig(min_edge_share=0.7, weak_edge_share=0.6))
