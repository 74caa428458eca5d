"""Which publisher is used where several publish, without a bus."""

import secrets

import pytest

from rpod_runtime.delivery.holders import (
    MOST_NAMES,
    MOST_PEERS,
    Announcements,
    Holders,
    Peer,
    SecondPublisherError,
)
from rpod_schemas.errors import MessageRejectedError

FIRST, SECOND = Peer(b"1" * 16, "one"), Peer(b"2" * 16, "two")


def hear(holders, peer, now_s):
    """Let a valid message arrive; return whether it is used."""
    try:
        holders.admit("topic", peer, now_s)
        holders.hold("topic", peer, now_s)
    except SecondPublisherError:
        return False
    return True


def test_the_first_valid_publisher_holds_a_topic_not_the_first_one():
    holders = Holders()
    holders.admit("topic", FIRST, 0.0)  # its message turns out to be unusable
    assert hear(holders, SECOND, 0.1)
    assert not hear(holders, FIRST, 0.2)
    assert [*holders.rivals(0.3)] == [("topic", SECOND, FIRST)]
    assert [*holders.rivals(9.0)] == []


def test_a_slow_sensor_keeps_its_topic_between_two_scans():
    holders = Holders()
    for second in (0.0, 5.0, 10.0):
        assert hear(holders, FIRST, second)
    assert not hear(holders, SECOND, 14.9)
    assert hear(holders, SECOND, 25.1)


def test_the_last_frames_of_a_publisher_that_is_gone_do_not_keep_its_successor_out():
    holders = Holders()
    assert hear(holders, FIRST, 1.0)
    holders.admit("topic", FIRST, 1.9)  # waits while its publisher ends
    holders.leave("topic", FIRST.session, now_s=2.0)
    holders.hold("topic", FIRST, 1.9)
    assert hear(holders, FIRST, 2.05), "it is still used"
    assert hear(holders, SECOND, 2.1)
    assert [*holders.rivals(2.1)] == [], "nobody is told of two publishers"


def test_a_publisher_whose_token_was_gone_for_a_while_holds_its_topic_again():
    holders = Holders()
    assert hear(holders, FIRST, 1.0)
    holders.leave("topic", FIRST.session, now_s=2.0)
    assert hear(holders, FIRST, 2.1)
    assert hear(holders, FIRST, 4.1)
    assert not hear(holders, SECOND, 4.2)


def test_what_is_remembered_of_publishers_is_bounded():
    holders, announcements = Holders(), Announcements[int]()
    assert hear(holders, FIRST, 0.0)
    announcements.put("frame", FIRST, 0)
    for number in range(1000):
        peer = Peer(secrets.token_bytes(16), str(number))
        hear(holders, FIRST, 1e-3 * number)
        assert not hear(holders, peer, 1e-3 * number)
        announcements.put("frame", peer, number)
    assert len([*holders.peers]) <= MOST_PEERS + 1
    assert len([*announcements.peers]) <= MOST_PEERS
    assert announcements.of("frame", "") == (FIRST, 0)
    for number in range(1, MOST_NAMES):
        announcements.put(f"frame{number}", FIRST, number)
    with pytest.raises(MessageRejectedError, match="too_many"):
        announcements.put("one more", FIRST, 0)


def test_of_what_was_announced_the_own_counts_first_then_the_earliest_that_is_not_gone():
    announcements = Announcements[str]()
    announcements.put("frame", FIRST, "first")
    announcements.put("frame", SECOND, "second")
    assert announcements.of("frame", "two") == (SECOND, "second")
    assert announcements.of("frame", "another node") == (FIRST, "first")
    announcements.leave(lambda name: name == "frame", "one")
    assert announcements.of("frame", "another node") == (SECOND, "second")
    announcements.leave(lambda name: name == "frame", "two")
    assert announcements.of("frame", "another node") == (SECOND, "second")
    assert announcements.of("other", "") is None


def test_a_reset_does_not_prefer_content_of_a_publisher_that_is_gone():
    announced, first, second, third = Announcements(), Peer(b"1"), Peer(b"2", "two"), Peer(b"3", "three")
    for peer in (first, second, third):
        announced.put("mount", peer, peer.gid)
    announced.leave(lambda _: True, "three")
    announced.release(keep="")
    assert announced.of("mount", "") == (second, b"2")
    announced.leave(lambda _: True, "two")
    announced.leave(lambda _: True, "")
    announced.release(keep="")
    assert announced.of("mount", "") == (third, b"3")  # all are gone: the newest
    announced.put("mount", first, b"4")
    assert announced.of("mount", "") == (first, b"4")
