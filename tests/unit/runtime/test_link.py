import logging

from rpod_runtime.bus.link import MOST_OUTAGES, Link, Outage
from rpod_runtime.health import HealthBook

NS = 10**9


def test_an_outage_is_told_in_lines_and_in_diagnostics_afterwards(caplog):
    health = HealthBook("motion")
    link = Link(health, "tcp/127.0.0.1:7447")
    link.note("router", opened=True, now_ns=0)
    assert not link.lost
    assert health.counters() == {}
    with caplog.at_level(logging.WARNING):
        link.note("router", opened=False, now_ns=10 * NS)
        assert link.lost
        link.note("another", opened=True, now_ns=12 * NS)
    assert not link.lost
    assert link.outages() == (Outage(10 * NS, 12 * NS),)
    assert [record.getMessage().split(":")[0] for record in caplog.records] == ["bus lost", "bus regained"]
    told = health.diagnostic(1)
    assert told.values["bus/lost"] == "1"
    assert told.values["bus/outage"] == "1970-01-01T00:00:10.000Z to 1970-01-01T00:00:12.000Z (2.0 s)"


def test_the_bus_is_there_as_long_as_one_router_is():
    link = Link(HealthBook("motion"), "e")
    for router in ("a", "b"):
        link.note(router, opened=True, now_ns=0)
    link.note("a", opened=False, now_ns=1)
    assert not link.lost


def test_outages_since_a_time_are_those_that_ended_later():
    link = Link(HealthBook("motion"), "e")
    for at_ns in (0, 20, 40):
        link.note("r", opened=True, now_ns=at_ns)
        link.note("r", opened=False, now_ns=at_ns + 10)
    assert [outage.begin_ns for outage in link.outages(20)] == [30, 50]


def test_many_outages_are_bounded_and_none_is_forgotten():
    link = Link(HealthBook("motion"), "e")
    for number in range(MOST_OUTAGES + 5):
        link.note("r", opened=True, now_ns=2 * number)
        link.note("r", opened=False, now_ns=2 * number + 1)
    outages = link.outages()
    assert len(outages) == MOST_OUTAGES
    assert outages[0].begin_ns == 1
