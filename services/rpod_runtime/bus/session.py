"""Opens Zenoh sessions as client or router, without scouting and without shared memory.

Shared memory is off because each restart of a publisher locks another block in its receivers.
"""

import json
import logging
import socket
import time
from pathlib import Path
from threading import Event
from typing import Any

import zenoh

from rpod_runtime.bus.refusal import why_refused
from rpod_runtime.bus.starts import next_start
from rpod_runtime.errors import EndpointError, NoRouterError, RefusedByRouterError
from rpod_schemas.config.facility.link import LinkConfig
from rpod_schemas.config.service import BusConfig, RouterConfig
from rpod_schemas.topics import TRUTH_TOPICS

log = logging.getLogger(__name__)

_STALLED_US = 1_000_000
"""Longest wait of a message that may not be dropped, microseconds; then Zenoh closes the link and connects
again. Clients that find a restarted router ask each other for what they missed, all at once, and may wait
for each other: by Zenoh's default for 5 s. An image of 0.5 MB passes a link of 4 Mbit/s in this time."""
_LARGEST_BYTES = 1 << 28
"""Largest message that is put together from fragments, bytes: more than the largest image or point cloud
within the ICD's bounds. Zenoh's default lets a peer take 1 GiB of each of its receivers."""
_RETRY_S = 0.25
_LEAST_TRIES = 3
"""Least number of tries before a client gives up, even after the time: the process may have stood still."""
_RETRY = {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 2}
"""How often a client tries to reach a lost router: it reconnects half a second after the router's return."""
_HANDSHAKE_MS, _PENDING = 1000, 4000
"""Longest time for a new connection to identify itself, and largest number of connections that have not done
so yet: idle ones keep nobody out."""
_REMIND_S = 10.0
_STARTS = 1024
"""Number of identities that a configured one stands for: it, followed by three hexadecimal digits."""
_LONGEST_ID = 29
"""Number of digits that are kept of a configured identity: Zenoh's have 32."""


def _zenoh_config(
    link: LinkConfig,
    *,
    tls: dict[str, Any] | None = None,
    unicast: dict[str, Any] | None = None,
    **settings: Any,
) -> zenoh.Config:
    """Return Zenoh's settings.

    Queues hold 16 batches on a fast link, the most that Zenoh accepts: with its default of two, an image is
    dropped as soon as the receiver is slow, and so is a burst of messages from a process that had to wait.
    """
    queue = {
        "size": dict.fromkeys(("data", "data_high"), link.queued_batches),
        "congestion_control": {
            "block": {"wait_before_close": _STALLED_US},
            "drop": {"max_wait_before_drop_fragments": round(link.wait_fragments_s * 1e6)},
        },
    }
    opening = {
        "open_timeout": round(link.open_timeout_s * 1e3),
        "compression": {"enabled": link.compression},
    }
    common = {
        "timestamping": {"enabled": True},
        "qos": {"network": _overwrites(link)},
        "transport": {
            "shared_memory": {"enabled": False},
            "unicast": opening | (unicast or {}),
            "link": {
                "tx": {"lease": round(link.lease_s * 1e3), "queue": queue},
                "rx": {"max_message_size": _LARGEST_BYTES},
                "tcp": {"so_sndbuf": link.send_buffer_bytes},
                "tls": (tls or {}) | {"so_sndbuf": link.send_buffer_bytes},
            },
        },
    }
    return zenoh.Config.from_json5(json.dumps(common | settings))


def _overwrites(link: LinkConfig) -> list[dict[str, Any]]:
    """Return how large messages are sent, where that is not as their publishers want it."""
    if not link.newest_large:
        return []
    large = {"payload_size": f"{link.large_bytes}..", "messages": ["put"], "flows": ["egress"]}
    return [large | {"overwrite": {"congestion_control": "block_first"}}]


def _tls(folder: Path | None, *, listens: bool) -> dict[str, Any] | None:
    """Return Zenoh's settings for the credentials in a folder. Raises ``CredentialsError``."""
    if folder is None:
        return None
    from rpod_security.credentials import Credentials  # noqa: PLC0415 - of an extra

    return Credentials.read(folder).tls(listens=listens)


def open_client(bus: BusConfig, *, zenoh_id: str = "", stop: Event | None = None) -> zenoh.Session:
    """Open a client session to the router, with an identity that begins with a given one, or a random one.

    With credentials the certificate says who the client is. Its Zenoh identity is random then and gives no
    right.

    Raises:
        CredentialsError: the folder of credentials cannot be used.
        NoRouterError: no router answered in time, or ``stop`` was set while waiting. It is also raised if the
            router refuses the identity because another client holds it.
        RefusedByRouterError: there is a router, and the reason for its refusal is known; with ``wait`` it is
            logged instead, since credentials may be replaced meanwhile.
    """
    identity: dict[str, Any] = {}
    if zenoh_id and bus.credentials is None:
        identity = {"id": _identity(zenoh_id, next_start(zenoh_id))}
    config = _zenoh_config(
        bus.link,
        mode="client",
        connect={"endpoints": [bus.connect], "timeout_ms": 0, "retry": _RETRY},
        tls=_tls(bus.credentials, listens=False),
        scouting={"multicast": {"enabled": False}, "gossip": {"enabled": False}},
        **identity,
    )
    stop = stop or Event()
    started_s = time.monotonic()
    reminded_s = started_s
    tries = 0
    while True:
        tries += 1
        try:
            return zenoh.open(config)
        except zenoh.ZError as error:
            waited_s = time.monotonic() - started_s
            if not (bus.wait or stop.is_set()) and (refused := why_refused(bus)):
                raise RefusedByRouterError(bus.connect, refused) from error
            is_over = waited_s >= bus.connect_timeout_s and tries >= _LEAST_TRIES
            if stop.is_set() or (not bus.wait and is_over):
                raise NoRouterError(bus.connect, waited_s, zenoh_id, stopped=stop.is_set()) from error
        if time.monotonic() - reminded_s > _REMIND_S:
            reminded_s = time.monotonic()
            hint = why_refused(bus) or "start one with 'rpod router'"
            log.warning("still waiting for a router at %s; %s", bus.connect, hint)
        stop.wait(_RETRY_S)


def _identity(zenoh_id: str, start: int) -> str:
    """Return the identity of one start of a client.

    Receivers would not hear a restarted client with the same identity (``rpod_runtime.bus.starts``).
    """
    return f"{zenoh_id[:_LONGEST_ID]}{start % _STARTS:03x}"


def open_router(config: RouterConfig) -> zenoh.Session:
    """Open a router session.

    On a plain bus gossip stays on, so that peers of rmw_zenoh find each other. On a secure one they would
    talk past the access rules: every node is a client there.

    Raises:
        EndpointError: the endpoint is in use or cannot be opened.
        CredentialsError: the folder of credentials cannot be used.
        RulesError: the file of rules cannot be used.
    """
    unicast = {
        "accept_timeout": _HANDSHAKE_MS,
        "accept_pending": _PENDING,
        "max_sessions": config.max_clients,
    }
    zenoh_config = _zenoh_config(
        config.link,
        mode="router",
        listen={"endpoints": [_listening(config)], "exit_on_failure": True},
        connect={
            "endpoints": list(config.connect),
            "timeout_ms": -1,  # without end, in the background
            "exit_on_failure": False,
            "retry": {"period_init_ms": 100, "period_max_ms": 500},
        },
        scouting={
            "multicast": {"enabled": False},
            "gossip": {"enabled": config.credentials is None},
            "delay": 1,  # ms; by default a router waits half a second for others that it scouts
        },
        adminspace={"enabled": False},
        unicast=unicast,
        tls=_router_tls(config),
        access_control=_access_control(config),
    )
    try:
        return zenoh.open(zenoh_config)
    except zenoh.ZError as error:
        raise EndpointError(config.listen, _without_places(str(error))) from error


def _without_places(text: str) -> str:
    """Return the cause in an error of Zenoh, which is in brackets, without places in Zenoh's source."""
    return text.split(" at /", maxsplit=1)[0].split(": [", 1)[-1]


def _router_tls(config: RouterConfig) -> dict[str, Any] | None:
    if config.credentials is None or config.link_credentials is None:
        return _tls(config.credentials, listens=True)
    from rpod_security.credentials import Credentials  # noqa: PLC0415 - of an extra

    return Credentials.read(config.credentials).joining(Credentials.read(config.link_credentials))


def _listening(config: RouterConfig) -> str:
    """Return the endpoint with the longest time of a TLS handshake, which is 10 s by default."""
    if config.credentials is None or "#" in config.listen:
        return config.listen
    return f"{config.listen}#tls_handshake_timeout_ms={round(config.handshake_timeout_s * 1000)}"


def _access_control(config: RouterConfig) -> dict[str, Any]:
    if config.rules is None:
        return truth_rules(config)
    from rpod_security.rules import load_access_control  # noqa: PLC0415 - roles take a second to import

    return load_access_control(config.rules)


def truth_rules(config: RouterConfig) -> dict[str, Any]:
    """Return Zenoh access rules that keep the truth from the estimators (ICD section 2).

    The rules hold in every domain and namespace. They name ``@adv`` keys explicitly, because ``**`` does not
    match the verbatim chunks of zenoh.ext's caches.
    """
    if not config.estimators:
        return {"enabled": False}  # Zenoh refuses an empty list of subjects
    keys = [f"*/**/{topic.name}/**" for topic in TRUTH_TOPICS]
    starts = [_identity(each, start) for each in config.estimators for start in range(_STARTS)]
    identities = [*config.estimators, *starts]
    return {
        "enabled": True,
        "default_permission": "allow",
        "rules": [
            {
                "id": "no-truth",
                "permission": "deny",
                "flows": ["egress"],
                "messages": ["put", "delete", "reply"],
                "key_exprs": keys + [f"{key}/@adv/**" for key in keys],
            }
        ],
        "subjects": [{"id": "estimators", "zids": identities}],
        "policies": [{"rules": ["no-truth"], "subjects": ["estimators"]}],
    }


def free_endpoint() -> str:
    """Return an endpoint on loopback that is free at this moment."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"
