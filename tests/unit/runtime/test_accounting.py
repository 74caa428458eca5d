from contextlib import suppress

import pytest

from rpod_runtime.delivery.accounting import (
    FARTHEST,
    MOST_KEYS,
    MOST_PUBLICATIONS,
    DuplicateError,
    JumpError,
    SequenceAccount,
    TooManyKeysError,
)
from rpod_schemas.rmw.wire import GID_BYTES, Attachment

A, B = b"a" * 16, b"b" * 16


def take(account, *numbers, gid=A, key="k"):
    """Return the numbers that are taken."""
    taken = []
    for number in numbers:
        with suppress(DuplicateError, JumpError):
            account.take(key, Attachment(number, 0, gid))
            taken.append(number)
    return taken


def test_counting_begins_with_the_first_number_seen():
    account = SequenceAccount()
    take(account, 7, 8, 9)
    assert (account.counts["k"].received, account.counts["k"].missed) == (3, 0)


def test_every_gap_is_counted_in_messages():
    account = SequenceAccount()
    take(account, 1, 2, 5, 9)
    assert account.counts["k"].missed == 2 + 3


def test_an_equal_or_lower_number_is_a_duplicate():
    account = SequenceAccount()
    assert take(account, 3, 3, 2, 4) == [3, 4]
    assert account.counts["k"].duplicates == 2
    assert account.counts["k"].received == 2


def test_a_restarted_publisher_is_counted_anew():
    account = SequenceAccount()
    take(account, 1, 2, 3)
    take(account, 1, 2, gid=B)
    assert (account.counts["k"].received, account.counts["k"].missed, account.counts["k"].duplicates) == (
        5,
        0,
        0,
    )


def test_keys_are_counted_apart():
    account = SequenceAccount()
    take(account, 1, 2)
    take(account, 5, key="other")
    assert account.counts["other"].missed == 0


def test_what_was_fetched_after_its_publisher_was_heard_live_is_recovered():
    account = SequenceAccount()
    account.take("k", Attachment(1, 0, A), fetched=True)
    account.take("k", Attachment(2, 0, A))
    for number in (3, 4):
        account.take("k", Attachment(number, 0, A), fetched=True)
    count = account.counts["k"]
    assert (count.received, count.recovered, count.missed) == (4, 2, 0)


def test_what_the_bus_gave_up_is_missed_once_whether_a_later_number_tells_before_after_or_never():
    account = SequenceAccount()
    take(account, 1, 2)
    account.miss(("k", A), 3)
    assert account.counts["k"].missed == 3
    take(account, 8)  # 3 to 7
    assert account.counts["k"].missed == 5
    account.miss(("k", A), 2)
    assert account.counts["k"].missed == 5
    take(account, 11)
    account.miss(("k", A), 2)
    assert account.counts["k"].missed == 7
    account.miss(("k", A), 4)
    assert account.counts["k"].missed == 11


# --- jumps ---


def test_numbers_may_start_at_0():
    account = SequenceAccount()
    assert take(account, 0, 1, 3) == [0, 1, 3]
    assert (account.counts["k"].received, account.counts["k"].missed) == (3, 1)


def test_a_number_far_away_is_refused_with_both_numbers_and_the_gid_and_the_sequence_goes_on():
    account = SequenceAccount()
    take(account, 1, 2)
    with pytest.raises(JumpError, match=f"2 to {2**40}, publisher {A.hex()}") as refused:
        account.take("k", Attachment(2**40, 0, A))
    assert (refused.value.jump.before, refused.value.jump.after) == (2, 2**40)
    assert take(account, *range(3, 100)) == [*range(3, 100)]
    assert (account.counts["k"].received, account.counts["k"].missed, account.counts["k"].duplicates) == (
        99,
        0,
        0,
    )


def test_jumps_between_the_messages_of_a_sequence_never_become_it():
    account = SequenceAccount()
    mixed = [number for genuine in range(1, 50) for number in (genuine, 2**40 + genuine, 2**41 + genuine)]
    assert take(account, *mixed) == [*range(1, 50)]


@pytest.mark.parametrize("first", [2**40, 5 * FARTHEST])
def test_a_publisher_that_jumps_and_goes_on_is_heard_again_after_three_messages(first):
    account = SequenceAccount()
    assert take(account, 1, 2, *range(first, first + 10)) == [1, 2, *range(first + 2, first + 10)]


def test_a_sequence_that_was_taken_over_comes_back_after_three_messages():
    account = SequenceAccount()
    take(account, 5000, 5001, 2**40, 2**40 + 1, 2**40 + 2)
    assert take(account, *range(5002, 5010)) == [*range(5004, 5010)]
    assert take(account, 2**40 + 3) == []


def test_one_number_far_away_said_again_and_again_is_not_taken():
    account = SequenceAccount()
    assert take(account, 1, *[2**40] * 20) == [1]


def test_a_long_gap_is_missed_but_for_what_was_refused_and_one_beyond_reason_is_not_counted():
    account = SequenceAccount()
    take(account, 1, 5001, 5002, 5003)
    assert account.counts["k"].missed == 4999
    take(account, 2**40, 2**40 + 1, 2**40 + 2)
    assert account.counts["k"].missed == 4999


def test_the_longest_gap_is_taken_at_once():
    account = SequenceAccount()
    assert take(account, 1, 1 + FARTHEST) == [1, 1 + FARTHEST]
    assert account.counts["k"].missed == FARTHEST - 1


def test_history_that_is_fetched_late_is_no_jump_backwards():
    account = SequenceAccount()
    take(account, 5000)
    for number in range(1, 10):
        with pytest.raises(DuplicateError):
            account.take("k", Attachment(number, 0, A), fetched=True)


def test_publishers_that_change_their_gid_each_time_push_out_the_silent_ones_only():
    account = SequenceAccount()
    for number in range(1, MOST_PUBLICATIONS + 100):
        account.take("k", Attachment(1, 0, number.to_bytes(GID_BYTES, "big")))
        account.take("k", Attachment(number, 0, b"g" * GID_BYTES))
    assert account.forgotten == 100
    with pytest.raises(DuplicateError):
        account.take("k", Attachment(MOST_PUBLICATIONS, 0, b"g" * GID_BYTES))
    account.take("k", Attachment(1, 0, (1).to_bytes(GID_BYTES, "big")))  # it was forgotten


def test_keys_without_end_are_refused():
    account = SequenceAccount()
    for number in range(MOST_KEYS):
        account.take(f"k{number}", Attachment(1, 0, bytes(GID_BYTES)))
    with pytest.raises(TooManyKeysError, match=f"of {MOST_KEYS} keys at most"):
        account.take("one more", Attachment(1, 0, bytes(GID_BYTES)))
    account.take("k0", Attachment(2, 0, bytes(GID_BYTES)))
    assert len(account.counts) == MOST_KEYS
