"""Counts of a run's integrity, minute by minute."""

import numpy as np
import pytest

from rpod_analysis.scoring.integrity import Alert, Integrities, IntegrityTotals
from rpod_analysis.scoring.score import Errors
from rpod_schemas.types import IntegrityState

NAN = float("nan")
NOMINAL, ALERT, UNAVAILABLE = IntegrityState.NOMINAL, IntegrityState.ALERT, IntegrityState.UNAVAILABLE


def errors(degrees):
    attitude_rad = np.zeros((len(degrees), 3))
    attitude_rad[:, 0] = np.deg2rad(degrees)
    return Errors(attitude_rad, np.zeros((len(degrees), 3)), np.full(len(degrees), NAN))


def told(*rows):
    return Integrities.of(
        [(stamp, int(state), level, 0.01, 2.0, 0.1, f"at {stamp}") for stamp, state, level in rows], 1
    )


def test_misleading_estimates_are_those_above_their_level_in_a_usable_state():
    totals = IntegrityTotals()
    minute = told(
        (1, UNAVAILABLE, NAN), (2, NOMINAL, 1.0), (3, NOMINAL, 1.0), (4, ALERT, 1.0), (5, NOMINAL, 3.0)
    )
    totals.take(minute, np.array([2, 3, 4, 5]), errors([0.5, 1.5, 9.0, 2.5]))
    found = totals.summary()
    assert (found.misleading, found.alerts) == (1, 1)
    assert found.availability == pytest.approx(3 / 4)


def test_an_alert_over_two_minutes_counts_once_and_misleading_is_unknown_without_truth():
    totals = IntegrityTotals()
    for minute in (told((1, NOMINAL, 1.0), (2, ALERT, 1.0)), told((3, ALERT, 1.0), (4, NOMINAL, 1.0))):
        totals.take(minute, np.array([9]), errors([NAN]))
    found = totals.summary()
    assert (found.misleading, found.alerts, found.availability) == (None, 1, 1.0)
    assert totals.alerts == [Alert(pytest.approx(1e-9), pytest.approx(3e-9), "at 2")]


def test_only_the_first_alerts_are_kept_and_the_last_one_may_not_end():
    totals = IntegrityTotals()
    states = [(stamp, ALERT if stamp % 2 else NOMINAL, 1.0) for stamp in range(400)]
    totals.take(told(*states), np.array([999]), errors([NAN]))
    assert (totals.summary().alerts, len(totals.alerts)) == (200, 100)
    assert totals.alerts[-1].end_s == pytest.approx(199e-9)
    open_end = IntegrityTotals()
    open_end.take(told((1, NOMINAL, 1.0), (2, ALERT, 1.0)), np.array([999]), errors([NAN]))
    assert open_end.alerts[0].end_s is None


def test_a_log_without_integrity_has_no_counts():
    totals = IntegrityTotals()
    totals.take(told(), np.array([1]), errors([0.1]))
    assert totals.summary() is None
