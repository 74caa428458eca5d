"""The proxy as a service: relays in an event loop, and faults by the query ``fault``."""

import asyncio
import time
from threading import Event

from rpod_proxy.plan import Plan
from rpod_proxy.relay import Address, Relay
from rpod_runtime import Node
from rpod_runtime.fault_book import FaultBook
from rpod_runtime.process.notify import manager
from rpod_schemas.config.facility.proxy import ProxyConfig
from rpod_schemas.control import Accepted, FaultRequest
from rpod_schemas.errors import ConfigurationError
from rpod_schemas.types import Health

_POLL_S = 0.005


def run(config: ProxyConfig, *, version: str, stop: Event) -> None:
    """Pass links on until stopped."""
    asyncio.run(_serve(config, version, stop))


async def _serve(config: ProxyConfig, version: str, stop: Event) -> None:
    relays = {
        name: Relay(_address(link.listen), _address(link.target), seed=config.seed + number)
        for number, (name, link) in enumerate(config.links.items())
    }
    try:
        for name, relay in relays.items():
            await _listen(config, name, relay)
        await asyncio.to_thread(_control, config, version, stop, asyncio.get_running_loop(), relays)
    finally:
        for relay in relays.values():
            relay.close()


async def _listen(config: ProxyConfig, name: str, relay: Relay) -> None:
    try:
        await relay.open()
    except OSError as error:
        raise ConfigurationError(
            config.instance, f"links.{name}.listen", f"{config.links[name].listen}: {error.strerror}"
        ) from error


def _control(
    config: ProxyConfig,
    version: str,
    stop: Event,
    loop: asyncio.AbstractEventLoop,
    relays: dict[str, Relay],
) -> None:
    """Take requests and set the links' conditions at their times, in a thread beside the event loop."""
    plan = Plan(tuple(relays))
    with Node(config, version=version, stop=stop) as node:
        book = FaultBook(node)

        def ask(request: FaultRequest) -> Accepted:
            plan.request(request, time.time_ns())
            return Accepted()

        node.serve("fault", FaultRequest, ask)
        node.ready(f"passing on the links of {', '.join(relays)}")
        before = dict.fromkeys(relays, plan.condition("", 0))
        while not stop.wait(_POLL_S):
            manager.alive()
            now_ns = time.time_ns()
            book.publish(plan.active(now_ns))
            for name, relay in relays.items():
                condition = plan.condition(name, now_ns)
                if condition != before[name]:
                    before[name] = condition
                    loop.call_soon_threadsafe(relay.set, condition)
                node.health.put(f"passed_bytes/{name}", relay.passed_bytes)
                node.health.put(f"connections/{name}", relay.connections)
            faults = [f"{fault.fault} of {fault.where}" for fault in plan.active(now_ns)]
            node.health.report(
                Health.WARN if faults else Health.OK,
                f"injecting {', '.join(faults)}" if faults else "passing on",
            )


def _address(text: str) -> Address:
    host, _, port = text.rpartition(":")
    return host, int(port)
