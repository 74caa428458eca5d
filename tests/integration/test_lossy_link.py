"""Packets are lost between two network namespaces, and no message of the truth is."""

import pytest
from lossy_link import Case, play, why_not


@pytest.fixture(scope="module", autouse=True)
def _link():
    if reason := why_not():
        pytest.skip(f"no link that loses packets can be made here: {reason}")


@pytest.mark.parametrize(
    "case",
    [Case(loss=0.01), Case(loss=0.05), Case(loss=0.01, rate_mbit_s=20.0)],
    ids=["1 %", "5 %", "1 % at 20 Mbit/s"],
)
def test_every_message_of_the_truth_arrives_in_order(case: Case, record_property):
    outcome = play(case, timeout_s=200.0)
    record_property("measured", str(outcome))
    assert (outcome.truth, outcome.missed, outcome.in_order) == (case.truth, 0, True)
    assert outcome.frames > 0
    assert outcome.passed > 0
    assert outcome.dropped > 0
