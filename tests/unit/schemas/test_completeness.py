"""What a log says of itself, and whether that agrees with what is in it."""

import pytest

from rpod_schemas.logs import Completeness, TopicCount, check_completeness, shortfalls


def record(**counts: TopicCount) -> dict[str, str]:
    return {f"/{topic}": count.model_dump_json() for topic, count in counts.items()}


def test_a_state_comes_back_from_its_record():
    state = Completeness(
        complete=False, reasons=("/tf: 2 missed on the bus",), continues="a.mcap", clock_jumps_s=(-37.0,)
    )
    assert Completeness.of_record(state.record()) == state


def test_a_file_without_a_record_was_not_closed_and_is_not_complete():
    said = check_completeness({}, {}, {"/tf": 3})
    assert said == Completeness(complete=False, reasons=("the file was not closed",))


@pytest.mark.parametrize(
    ("count", "found", "reason"),
    [
        (TopicCount(received=5, written=5, missed=2), 5, "/tf: 2 missed on the bus"),
        (TopicCount(received=5, written=3), 3, "/tf: 2 lost in the logger"),
        (TopicCount(received=5, written=5, rejected=1), 5, "/tf: 1 rejected"),
        (TopicCount(received=5, written=5, repeated=1), 5, "/tf: 5 in the file, 6 by its account"),
    ],
)
def test_a_record_that_the_account_or_the_file_contradicts_is_not_believed(count, found, reason):
    said = check_completeness(Completeness(complete=True).record(), record(tf=count), {"/tf": found})
    assert said == Completeness(complete=False, reasons=(reason,))


def test_what_agrees_is_believed_and_recovered_messages_are_no_shortfall():
    counts = record(tf=TopicCount(received=7, written=7, recovered=3, repeated=1, duplicates=2))
    assert check_completeness(Completeness(complete=True).record(), counts, {"/tf": 8}).complete


def test_a_topic_without_an_account_is_a_contradiction():
    assert shortfalls({}, {"/tf": 1}) == ("/tf: 1 in the file, 0 by its account",)
