"""What navigation did during a fault, from statuses and errors that are put in by hand."""

import numpy as np
import pytest

from rpod_analysis.scoring.fault_scores import FaultScore
from rpod_schemas.faults.injected import InjectedFault
from rpod_schemas.types import Mode

SECOND_NS = 1_000_000_000
T, C, LOST = Mode.TRACKING, Mode.COASTING, Mode.LOST


def score(begin_s=2, end_s=5, *minutes):
    found = FaultScore(InjectedFault("blackout", "pmd", begin_s * SECOND_NS), end_s * SECOND_NS)
    for first_s, modes in minutes:
        stamps = (first_s + np.arange(len(modes))) * SECOND_NS
        mode = np.array([int(each) for each in modes])
        found.take_statuses(stamps, mode, mode == T)
    return found


def test_modes_count_during_the_fault_and_times_run_from_its_begin_and_its_end():
    found = score(2, 5, (0, (T, T, C)), (3, (C, LOST, LOST, LOST, T, LOST)))
    outcome = found.outcome(SECOND_NS)
    assert (outcome.begin_s, outcome.frames) == (1.0, 3)
    assert (outcome.tracking_share, outcome.coasting_share) == (0.0, pytest.approx(2 / 3))
    assert (outcome.lost_after_s, outcome.tracking_again_s) == (2.0, 2.0)


def test_a_loss_after_the_target_was_tracked_again_is_not_the_faults():
    outcome = score(2, 5, (0, (T, T, C, C, C, T, LOST))).outcome(0)
    assert (outcome.lost_after_s, outcome.tracking_again_s) == (None, 0.0)


def test_only_errors_during_the_fault_count_and_without_truth_none_is_known():
    found = score(2, 5)
    assert found.outcome(0).wrong_accepted is None
    stamps = np.array([1, 2, 4, 5]) * SECOND_NS
    found.take_errors(
        stamps, np.array([90.0, 1, 20, 90]), np.array([9.0, 0.1, 0.2, 9]), np.array([1, 0, 1, 1]) > 0
    )
    outcome = found.outcome(0)
    assert (outcome.wrong_accepted, outcome.worst_deg, outcome.worst_m) == (1, 20.0, 0.2)
