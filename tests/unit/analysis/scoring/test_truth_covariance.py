"""A truth that states its own error: errors are compared with both covariances, and its share is told."""

import numpy as np
import pytest
from synthetic_log import Frame, SyntheticRun

from rpod_analysis import open_log
from rpod_analysis.scoring.run import stream_run
from rpod_analysis.scoring.run_checks import find_checks
from rpod_analysis.scoring.summarise import summarise
from rpod_motion.truth_error import TruthError
from rpod_schemas.config.motion import TruthErrorConfig

SIGMA = np.array([0.5e-3] * 3 + [np.radians(0.05)] * 3)
"""Standard deviations, m and rad: a better estimator than the truth of the 2018 paper's facility."""


def estimated(number, _time_s):
    error = SIGMA * np.random.default_rng((9, number)).standard_normal(6)
    return Frame(attitude_rad=error[3:], position_m=error[:3], covariance=np.diag(SIGMA**2))


def summary_of(path, **changes):
    SyntheticRun(duration_s=5.0, rate_hz=40.0, frame=estimated, **changes).write(path)
    with open_log(path) as log:
        return summarise(log, stream_run(log))


@pytest.fixture(scope="module")
def scored(tmp_path_factory):
    error = TruthError(TruthErrorConfig(correlation_s=0.05), seed=1, rate_hz=250.0)
    return summary_of(tmp_path_factory.mktemp("truth") / "epos.mcap", truth_error=error)


def test_errors_against_a_coarse_truth_are_consistent_with_both_covariances(scored):
    assert 4.5 < scored.consistency.nees_mean < 7.5
    assert scored.consistency.nees_share_in_95 > 0.9


def test_the_summary_and_the_checks_say_how_much_may_be_the_truths(scored):
    truth = scored.truth_error
    assert truth.position_m_rms == pytest.approx(np.sqrt(3.0) * 1.56e-3)
    assert truth.attitude_deg_rms == pytest.approx(np.sqrt(3.0) * 0.2)
    assert truth.position_share == pytest.approx(1.56**2 / (1.56**2 + 0.5**2), abs=0.12)
    (check,) = (check for check in find_checks(scored, 0) if check.question == "Truth")
    assert "2.7 mm" in check.answer
    assert check.good is None


def test_a_truth_that_states_nothing_counts_as_exact(tmp_path):
    summary = summary_of(tmp_path / "exact.mcap")
    assert summary.truth_error is None
    assert 4.5 < summary.consistency.nees_mean < 7.5
    assert all(check.question != "Truth" for check in find_checks(summary, 0))


def test_an_error_of_truth_that_it_does_not_state_is_taken_for_the_estimates(tmp_path):
    error = TruthError(TruthErrorConfig(correlation_s=0.05), seed=1, rate_hz=250.0)
    error.covariance = np.zeros((6, 6))
    assert summary_of(tmp_path / "silent.mcap", truth_error=error).consistency.nees_mean > 30.0
