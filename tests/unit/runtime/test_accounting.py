from rpod_runtime.accounting import Arrival, SequenceAccount
from rpod_schemas.wire import Attachment

A, B = b"a" * 16, b"b" * 16


def take(account, *numbers, gid=A, key="k"):
    return [account.take(key, Attachment(number, 0, gid)) for number in numbers]


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
    assert take(account, 3, 3, 2, 4) == [Arrival.NEXT, Arrival.DUPLICATE, Arrival.DUPLICATE, Arrival.NEXT]
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
