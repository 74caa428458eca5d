"""Packets are lost between two network namespaces, and no message of the truth is."""

from concurrent.futures import ThreadPoolExecutor

import pytest
from lossy_link import Case, Outcome, play, why_not

CASES = {
    "1 %": Case(loss=0.01),
    "5 %": Case(loss=0.05),
    "1 % at 20 Mbit/s": Case(loss=0.01, rate_mbit_s=20.0),
}


@pytest.fixture(scope="module")
def outcomes() -> dict[str, Outcome]:
    """The outcome of each case; all are played at the same time, in namespaces of their own."""
    if reason := why_not():
        pytest.skip(f"no link that loses packets can be made here: {reason}")
    with ThreadPoolExecutor(len(CASES)) as pool:
        played = list(pool.map(lambda case: play(case, timeout_s=200.0), CASES.values()))
    return dict(zip(CASES, played, strict=True))


@pytest.mark.parametrize("name", CASES)
def test_every_message_of_the_truth_arrives_in_order(outcomes, name, record_property):
    case, outcome = CASES[name], outcomes[name]
    record_property("measured", str(outcome))
    assert (outcome.truth, outcome.missed, outcome.in_order) == (case.truth, 0, True)
    assert outcome.frames > 0
    assert outcome.passed > 0
    assert outcome.dropped > 0
