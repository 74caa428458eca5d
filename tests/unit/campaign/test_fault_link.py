"""The link of a sequence: when messages arrive, and which are lost, in the time of the sequence."""

from types import SimpleNamespace

import pytest

from rpod_campaign.faults.cell import FaultCell
from rpod_campaign.faults.link import QUEUE_BYTES, Link
from rpod_schemas.messages import NANOSECONDS

BEGIN_S, END_S = 3.0, 5.0
IMAGE_BYTES = 250_000


def ns(time_s):
    return round(time_s * NANOSECONDS)


def image(name, size=IMAGE_BYTES):
    return SimpleNamespace(name=name, payload=bytes(size))


def arrivals(fault, size, *sent, until_s=20.0):
    """Return time and name of what arrives, of messages that are sent at some times, s."""
    cell = FaultCell(fault, size, END_S - BEGIN_S, "mockup", "pmd")
    link = Link(cell, begin_ns=ns(BEGIN_S), end_ns=ns(END_S), seed=1)
    for time_s, *messages in sent:
        link.send(messages, ns(time_s))
    return [
        (each.time_ns / NANOSECONDS, [one.name for one in each.messages])
        for each in link.arrived(ns(until_s))
    ]


def test_before_and_after_the_fault_all_arrives_at_once():
    for fault, size in (("link_delay", 0.2), ("link_rate", 1.0), ("link_cut", None)):
        sent = (2.9, image("a"), image("b")), (5.0, image("c"))
        assert arrivals(fault, size, *sent) == [(2.9, ["a", "b"]), (5.0, ["c"])]


def test_a_delay_moves_all_and_nothing_overtakes():
    sent = (3.0, image("a")), (4.9, image("b")), (5.0, image("c"))
    assert arrivals("link_delay", 0.2, *sent) == [(3.2, ["a"]), (5.1, ["b", "c"])]


def test_at_a_rate_a_message_takes_its_time_and_the_full_queue_drops():
    first, second = arrivals("link_rate", 10.0, (3.0, image("a"), image("b")))
    assert (first, second) == ((pytest.approx(3.2), ["a"]), (pytest.approx(3.4), ["b"]))
    names = "abcdefgh"
    came = arrivals("link_rate", 10.0, (3.0, *map(image, names)))
    assert [name for _, found in came for name in found] == list(names)[: QUEUE_BYTES // IMAGE_BYTES]


def test_what_is_larger_than_the_queue_passes_while_nothing_waits():
    assert len(arrivals("link_rate", 10.0, (3.0, image("a", 2 * QUEUE_BYTES)))) == 1


def test_a_stall_holds_all_back_until_its_end_and_a_dead_or_cut_link_loses_it():
    sent = (3.0, image("a")), (4.0, image("b")), (6.0, image("c"))
    assert arrivals("link_stall", None, *sent) == [(5.0, ["a", "b"]), (6.0, ["c"])]
    assert arrivals("link_half_open", None, *sent) == arrivals("link_cut", None, *sent) == [(6.0, ["c"])]


def test_lost_packets_cost_time_and_no_message():
    sent = [(3.0 + 0.1 * number, image(str(number))) for number in range(10)]
    came = arrivals("link_loss", 0.05, *sent)
    late_s = [time_s - 3.0 - 0.1 * int(name) for time_s, names in came for name in names]
    assert len(late_s) == 10
    assert max(late_s) > 1e-3
    assert arrivals("link_loss", 0.05, *sent) == came, "of one seed"


def test_what_was_returned_does_not_come_again():
    cell = FaultCell("link_delay", 0.2, 2.0, "mockup", "pmd")
    link = Link(cell, begin_ns=ns(BEGIN_S), end_ns=ns(END_S), seed=1)
    link.send([image("a")], ns(3.0))
    assert link.arrived(ns(3.1)) == []
    assert len(link.arrived(ns(3.2))) == 1
    assert link.arrived(ns(9.0)) == []
