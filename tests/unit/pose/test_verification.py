from dataclasses import replace

import numpy as np
import pytest
from pydantic import ValidationError

from rpod_pose.ports import Registration
from rpod_pose.verification import Record, doubt
from rpod_schemas.config.verification import VerificationConfig
from rpod_schemas.poses import make_pose
from rpod_schemas.types import Source

LIMITS = VerificationConfig(max_cost_m2=0.01, min_explained_share=0.7, min_inlier_share=0.3, min_inliers=12)
GOOD = Registration(
    Source.PMD_DEPTH,
    T_sensor_target=make_pose(),
    cost_m2=0.01,
    inliers=12,
    inlier_share=0.3,
    explained_share=0.7,
    covariance=np.eye(6),
)


def test_a_registration_at_its_limits_is_believed():
    assert doubt(GOOD, LIMITS) == ""


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"cost_m2": 0.0123}, "cost 0.012 m2 above 0.01"),
        ({"cost_m2": float("nan")}, "cost nan m2 above 0.01"),
        ({"inliers": 11}, "11 inliers, needs 12"),
        ({"inlier_share": 0.29}, "inlier share 0.29 below 0.30"),
        ({"explained_share": 0.654}, "explained share 0.65 below 0.70"),
        ({"covariance": np.full((6, 6), np.nan)}, "no covariance"),
        ({"T_sensor_target": None, "reason": "3 inliers, 12 needed"}, "3 inliers, 12 needed"),
        ({"T_sensor_target": None, "reason": ""}, "no pose"),
    ],
)
def test_a_doubt_is_told_in_words(changes, words):
    assert doubt(replace(GOOD, **changes), LIMITS) == words


@pytest.mark.parametrize("unknown", ["inlier_share", "explained_share"])
def test_a_share_that_the_method_does_not_know_is_not_asked(unknown):
    assert doubt(replace(GOOD, **{unknown: float("nan")}), LIMITS) == ""


def test_the_first_of_several_doubts_is_told():
    assert doubt(replace(GOOD, cost_m2=1.0, inliers=0), LIMITS).startswith("cost")


def test_a_track_may_be_asked_for_less_and_never_for_more() -> None:
    limits = LIMITS.model_copy(update={"min_tracked_share": 0.5})
    assert limits.while_tracking.min_explained_share == 0.5
    assert LIMITS.while_tracking == LIMITS
    with pytest.raises(ValidationError, match="a track asks no more than an acquisition"):
        VerificationConfig(max_cost_m2=0.01, min_explained_share=0.7, min_tracked_share=0.8)


@pytest.mark.parametrize(
    "changes",
    [{"cost_m2": 1.0}, {"inliers": 1}, {"inlier_share": 0.0}, {"explained_share": 0.0}],
)
def test_what_a_method_has_judged_by_itself_is_not_asked_again(changes):
    assert doubt(replace(GOOD, **changes), LIMITS)
    assert doubt(replace(GOOD, **changes, judged=True), LIMITS) == ""


def test_what_a_method_doubts_by_itself_is_not_believed():
    reason = "does not explain the scan"
    assert doubt(replace(GOOD, judged=True, reason=reason), LIMITS) == reason
    assert doubt(replace(GOOD, judged=True, T_sensor_target=None), LIMITS) == "no pose"


@pytest.mark.parametrize(
    ("wide", "judged", "words"),
    [
        (0, False, "the position is left open: sigma 0.3 m, 0.2 at most"),
        (0, True, "the position is left open: sigma 0.3 m, 0.2 at most"),
        (5, True, "the attitude is left open: sigma 17 deg, 10 at most"),
        (None, True, ""),
    ],
)
def test_a_frame_that_leaves_the_pose_open_does_not_start_a_track_but_may_go_on_with_one(wide, judged, words):
    limits = LIMITS.model_copy(update={"max_sigma_m": 0.2, "max_sigma_deg": 10.0})
    covariance = np.eye(6) * 1e-4
    if wide is not None:
        covariance[wide, wide] = 0.09
    registration = replace(GOOD, covariance=covariance, judged=judged)
    assert doubt(registration, limits) == words
    assert doubt(registration, limits.while_tracking) == doubt(registration, LIMITS) == ""


def test_a_record_forgets_and_grants_a_stream_some_frames_at_first():
    right, wrong, silent = (
        GOOD,
        replace(GOOD, contradicted=True),
        Registration(Source.PMD_DEPTH, reason="dark"),
    )
    record = Record()
    for _ in range(5):
        record = record.after(wrong)
    assert 0.15 < record.share < 0.25
    assert record.after(silent) == record
    for _ in range(300):
        record = record.after(wrong)
    assert record.share > 0.75
    for _ in range(300):
        record = record.after(right)
    assert record.share < 0.05
