from dataclasses import replace

import numpy as np
import pytest
from pydantic import ValidationError

from rpod_pose.acceptance import accepted_by_residuals
from rpod_pose.belief import SYMMETRY, Belief, Record, Rival, contradicted, doubtful, undetermined
from rpod_pose.ports import Acquisition, Outcome, Registration
from rpod_pose.search.hypotheses import belief_with_rivals
from rpod_schemas.config.acceptance import AcceptanceConfig
from rpod_schemas.poses import make_pose
from rpod_schemas.types import BeliefLevel, Source

LIMITS = AcceptanceConfig(max_cost_m2=0.01, min_explained_share=0.7, min_inlier_share=0.3, min_inliers=12)
GOOD = Registration(
    Source.PMD_DEPTH,
    T_sensor_target=make_pose(),
    cost_m2=0.01,
    inliers=12,
    inlier_share=0.3,
    explained_share=0.7,
    covariance=np.eye(6),
)


def belief_of(limits: AcceptanceConfig = LIMITS, **changes: object) -> Belief:
    return accepted_by_residuals(replace(GOOD, **changes), limits).belief  # type: ignore[arg-type]


def test_a_registration_at_its_limits_is_accepted_with_its_figures_as_evidence():
    belief = belief_of()
    assert (belief.level, belief.refusal) == (BeliefLevel.ACCEPTED, "")
    assert belief.evidence == {"cost_m2": 0.01, "inliers": 12, "inlier_share": 0.3, "explained_share": 0.7}


@pytest.mark.parametrize(
    ("changes", "level", "words"),
    [
        ({"cost_m2": 0.0123}, BeliefLevel.CONTRADICTED, "cost 0.012 m2 above 0.01 m2"),
        ({"cost_m2": float("nan")}, BeliefLevel.CONTRADICTED, "cost nan m2 above 0.01 m2"),
        ({"inliers": 11}, BeliefLevel.DOUBTFUL, "11 inliers, 12 needed"),
        ({"inlier_share": 0.29}, BeliefLevel.CONTRADICTED, "inlier share 0.29 below 0.30"),
        ({"explained_share": 0.654}, BeliefLevel.CONTRADICTED, "explained share 0.65 below 0.70"),
        ({"covariance": np.full((6, 6), np.nan)}, BeliefLevel.CONTRADICTED, "no covariance"),
    ],
)
def test_what_is_beyond_a_limit_is_refused_with_its_figures(changes, level, words):
    registration = accepted_by_residuals(replace(GOOD, **changes), LIMITS)
    assert (registration.belief.level, registration.belief.refusal) == (level, words)
    assert not registration.begins_track
    assert not registration.continues_track


@pytest.mark.parametrize("unknown", ["inlier_share", "explained_share"])
def test_a_share_that_the_method_does_not_know_is_not_asked(unknown):
    assert belief_of(**{unknown: float("nan")}).begins_track


def test_a_frame_without_a_pose_keeps_its_own_reason():
    none = Registration.none(Source.PMD_DEPTH, "3 inliers, 12 needed")
    assert accepted_by_residuals(none, LIMITS) is none
    assert not none.begins_track
    assert not none.continues_track
    assert none.belief.refusal == "3 inliers, 12 needed"


def test_a_running_track_may_use_what_is_too_little_to_begin_with():
    limits = LIMITS.model_copy(update={"min_tracked_share": 0.5})
    belief = belief_of(limits, explained_share=0.6)
    assert belief.continues_track
    assert not belief.begins_track
    assert belief.refusal == "explained share 0.60 below 0.70"
    assert not belief_of(limits, explained_share=0.4).continues_track


def test_a_running_track_is_never_asked_for_more():
    with pytest.raises(ValidationError, match="a running track needs no more than an acquisition"):
        AcceptanceConfig(min_explained_share=0.7, min_tracked_share=0.8)


@pytest.mark.parametrize(
    ("wide", "words"),
    [
        (0, "the position is undetermined: sigma 0.3 m, limit 0.2 m; wait for another side"),
        (5, "the attitude is undetermined: sigma 17 deg, limit 10 deg; wait for another side"),
        (None, ""),
    ],
)
def test_what_a_measurement_leaves_undetermined_is_named(wide, words):
    covariance = np.eye(6) * 1e-4
    if wide is not None:
        covariance[wide, wide] = 0.09
    assert (
        undetermined(covariance, max_sigma_m=0.2, max_sigma_deg=10.0).removesuffix(", or look from nearer")
        == words
    )


def test_a_covariance_that_is_not_known_determines_nothing():
    assert "undetermined" in undetermined(np.full((6, 6), np.nan), max_sigma_m=0.2, max_sigma_deg=10.0)


def acquired(level: BeliefLevel, *names: str, log_likelihood: float = 0.0) -> Acquisition:
    rivals = tuple(Rival(name, make_pose(), log_likelihood) for name in names)
    return Acquisition(replace(GOOD, belief=Belief(level, rivals=rivals)))


@pytest.mark.parametrize(
    ("found", "outcome", "begins"),
    [
        (acquired(BeliefLevel.ACCEPTED), Outcome.ACCEPTED, True),
        (acquired(BeliefLevel.ACCEPTED, "turned by 90 deg"), Outcome.ACCEPTED, True),
        (acquired(BeliefLevel.DOUBTFUL, "turned by 90 deg"), Outcome.AMBIGUOUS, False),
        (acquired(BeliefLevel.DOUBTFUL, SYMMETRY, "turned by 90 deg"), Outcome.AMBIGUOUS, False),
        (acquired(BeliefLevel.DOUBTFUL, SYMMETRY, SYMMETRY), Outcome.AMBIGUOUS, True),
        (acquired(BeliefLevel.CONTRADICTED), Outcome.FAILED, False),
        (Acquisition(Registration.none(Source.NONE, "dark")), Outcome.FAILED, False),
    ],
)
def test_a_track_begins_where_no_rival_is_left_that_a_measurement_could_exclude(found, outcome, begins):
    assert (found.outcome, found.begins_track) == (outcome, begins)


def test_hypotheses_are_weighed_by_their_likelihoods():
    found = acquired(BeliefLevel.DOUBTFUL, "turned by 90 deg", log_likelihood=-np.log(3.0))
    assert [item.weight for item in found.hypotheses] == pytest.approx([0.75, 0.25])
    assert [item.name for item in found.hypotheses] == ["", "turned by 90 deg"]
    assert acquired(BeliefLevel.CONTRADICTED, SYMMETRY).hypotheses == ()


@pytest.mark.parametrize("against", [doubtful("few edges"), contradicted("a detail contradicts the pose")])
def test_a_record_forgets_and_assumes_at_first_that_frames_agree(against):
    record = Record()
    for _ in range(5):
        record = record.after(against)
    assert 0.15 < record.share < 0.25
    for _ in range(300):
        record = record.after(against)
    assert record.share > 0.75
    for _ in range(300):
        record = record.after(Belief())
    assert record.share < 0.05


def test_the_weight_in_a_reason_is_the_one_that_is_compared_with_the_limit():
    pose = make_pose()
    twins = (Rival(SYMMETRY, pose, 0.0), *(Rival("turned by 180 deg", pose, -2.0) for _ in range(2)))
    reason = belief_with_rivals(twins, Belief(BeliefLevel.ACCEPTED), least=0.95).reason
    weight = 2.0 / (2.0 + 2.0 * np.exp(-2.0))
    assert f"the best with its symmetries has weight {weight:.2f} (0.95 needed)" in reason
