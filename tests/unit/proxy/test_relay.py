"""The proxy's relay over real sockets, without a bus: what arrives in each condition of the link."""

import asyncio
import socket
from pathlib import Path

import pytest

from rpod_proxy.condition import GOOD, MBIT, Condition, condition_of
from rpod_proxy.plan import Plan
from rpod_proxy.relay import Relay
from rpod_runtime.errors import RefusedError
from rpod_schemas.control import FaultRequest

TIMEOUT_S = 20.0
SECOND_NS = 1_000_000_000


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


class Link:
    """A service and a router with a relay between them; the router sends everything back."""

    async def __aenter__(self):
        self.server = await asyncio.start_server(self._echo, "127.0.0.1", 0)
        address = ("127.0.0.1", free_port())
        self.relay = Relay(address, self.server.sockets[0].getsockname(), seed=3)
        await self.relay.open()
        self.address = address
        return self

    async def __aexit__(self, *_) -> None:
        self.relay.close()
        self.server.close()

    async def _echo(self, reader, writer) -> None:
        try:
            while data := await reader.read(4096):
                writer.write(data)
                await writer.drain()
        except OSError:
            pass
        finally:
            writer.close()

    async def connect(self):
        return await asyncio.open_connection(*self.address)


def play(body) -> None:
    async def run() -> None:
        async with Link() as link:
            await asyncio.wait_for(body(link), TIMEOUT_S)

    asyncio.run(run())


@pytest.mark.parametrize(
    "condition", [GOOD, Condition(delay_s=0.02), Condition(loss=0.02), Condition(rate_B_s=8e6)]
)
def test_all_bytes_arrive_in_their_order_on_a_slow_a_far_and_a_lossy_link(condition):
    async def body(link: Link) -> None:
        link.relay.set(condition)
        reader, writer = await link.connect()
        sent = bytes(range(256)) * 256
        writer.write(sent)
        assert await reader.readexactly(len(sent)) == sent
        assert link.relay.passed_bytes == 2 * len(sent)
        writer.close()

    play(body)


def test_what_is_sent_in_a_stall_arrives_when_it_ends():
    async def body(link: Link) -> None:
        reader, writer = await link.connect()
        writer.write(b"before")
        assert await reader.readexactly(6) == b"before"
        link.relay.set(Condition(stalled=True))
        writer.write(b"during")
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(reader.readexactly(1), 0.1)
        link.relay.set(GOOD)
        assert await reader.readexactly(6) == b"during"
        writer.close()

    play(body)


def test_a_dead_link_says_nothing_and_is_reset_when_it_returns():
    async def body(link: Link) -> None:
        reader, writer = await link.connect()
        writer.write(b"before")
        await reader.readexactly(6)
        link.relay.set(Condition(dead=True))
        writer.write(b"lost")
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(reader.read(1), 0.1)
        link.relay.set(GOOD)
        with pytest.raises(ConnectionResetError):
            await reader.readexactly(1)
        writer.close()
        again, writer = await link.connect()
        writer.write(b"new")
        assert await again.readexactly(3) == b"new"
        writer.close()

    play(body)


@pytest.mark.parametrize("condition", [Condition(stalled=True), Condition(dead=True), Condition(delay_s=0.3)])
def test_the_end_of_a_connection_passes_a_bad_link_no_sooner_than_its_bytes(condition):
    async def body(link: Link) -> None:
        reader, writer = await link.connect()
        writer.write(b"before")
        await reader.readexactly(6)
        link.relay.set(condition)
        writer.write_eof()
        end = asyncio.create_task(reader.read(1))
        done, _ = await asyncio.wait([end], timeout=0.2)
        assert not done
        link.relay.set(GOOD)
        if condition.dead:
            with pytest.raises(ConnectionResetError):
                await end
        else:
            assert await end == b""
        writer.close()

    play(body)


def test_a_cut_closes_each_connection_old_and_new():
    async def body(link: Link) -> None:
        reader, writer = await link.connect()
        writer.write(b"x")
        await reader.readexactly(1)
        link.relay.set(Condition(cut=True))
        new_reader, new_writer = await link.connect()
        for each in (reader, new_reader):
            with pytest.raises(ConnectionResetError):
                await each.readexactly(1)
        for each in (writer, new_writer):
            each.close()

    play(body)


def test_delays_add_up_losses_combine_and_the_lowest_rate_counts():
    faults = [
        ("link_delay", 0.1),
        ("link_delay", 0.2),
        ("link_loss", 0.5),
        ("link_loss", 0.5),
        ("link_rate", 10.0),
    ]
    found = condition_of([*faults, ("link_rate", 2.0), ("link_stall", None)])
    assert found == Condition(delay_s=pytest.approx(0.3), loss=0.75, rate_B_s=2.0 * MBIT, stalled=True)
    assert condition_of([]) == GOOD


def test_a_fault_holds_for_its_link_and_its_time_and_others_are_refused():
    plan = Plan(("estimator", "logger"))
    plan.request(
        FaultRequest(fault="link_stall", service="logger", start_s=1.0, duration_s=2.0), 5 * SECOND_NS
    )
    times = [plan.condition("logger", second * SECOND_NS).stalled for second in (5, 6, 7, 8)]
    assert times == [False, True, True, False]
    assert not plan.condition("estimator", 6 * SECOND_NS).stalled
    with pytest.raises(RefusedError, match="the link of motion does not pass"):
        plan.request(FaultRequest(fault="link_stall", service="motion", duration_s=1.0), 0)
    with pytest.raises(RefusedError, match="dropout is no fault of a link"):
        plan.request(FaultRequest(fault="dropout", duration_s=1.0), 0)


def test_faults_without_end_are_refused_until_some_are_over():
    plan, asked = Plan(("logger",)), FaultRequest(fault="link_stall", service="logger", duration_s=2.0)
    for _ in range(500):
        plan.request(asked, 0)
    with pytest.raises(RefusedError, match="500 faults are planned or active already"):
        plan.request(asked, SECOND_NS)
    plan.request(asked, 3 * SECOND_NS)
    assert len(plan.active(3 * SECOND_NS)) == 1


def test_a_router_that_refuses_leaves_no_socket_open():
    async def body(_) -> None:
        refused = Relay(("127.0.0.1", free_port()), ("127.0.0.1", free_port()))
        before = len(list(Path("/proc/self/fd").iterdir()))
        with pytest.raises(ConnectionRefusedError) as refusal:  # holds what the failed call had
            await refused._connected()
        assert refusal
        assert len(list(Path("/proc/self/fd").iterdir())) == before

    play(body)
