"""Opens Zenoh sessions as client or router, without scouting and without shared memory.

Shared memory is off because each restart of a publisher locks another block in its receivers.
"""

import json
import logging
import socket
import time
from threading import Event
from typing import Any

import zenoh

from rpod_runtime.errors import EndpointError, NoRouterError
from rpod_schemas.config.service import BusConfig, RouterConfig
from rpod_schemas.topics import TRUTH_TOPICS

log = logging.getLogger(__name__)

_QUEUED_BATCHES = 16
"""Number of batches that may wait for a congested link, for bulky and for small messages each.

A batch is 64 KiB, and 16 is the most that Zenoh accepts. With its default of two, an image is dropped as soon
as the receiver is slow, and so is a burst of messages from a process that had to wait.
"""
_RETRY_S = 0.25
_REMIND_S = 10.0


def _zenoh_config(**settings: Any) -> zenoh.Config:
    common = {
        "timestamping": {"enabled": True},
        "transport": {
            "shared_memory": {"enabled": False},
            "link": {"tx": {"queue": {"size": dict.fromkeys(("data", "data_high"), _QUEUED_BATCHES)}}},
        },
    }
    return zenoh.Config.from_json5(json.dumps(common | settings))


def open_client(bus: BusConfig, *, zenoh_id: str = "", stop: Event | None = None) -> zenoh.Session:
    """Open a client session to the router, with a given identity or a random one.

    Raises:
        NoRouterError: no router answered in time, or ``stop`` was set while waiting. It is also raised if the
            router refuses the identity because another client holds it.
    """
    identity = {"id": zenoh_id} if zenoh_id else {}
    config = _zenoh_config(
        mode="client",
        connect={"endpoints": [bus.connect], "timeout_ms": 0},
        scouting={"multicast": {"enabled": False}, "gossip": {"enabled": False}},
        **identity,
    )
    stop = stop or Event()
    started_s = time.monotonic()
    reminded_s = started_s
    while True:
        try:
            return zenoh.open(config)
        except zenoh.ZError as error:
            waited_s = time.monotonic() - started_s
            if stop.is_set() or (not bus.wait and waited_s >= bus.connect_timeout_s):
                raise NoRouterError(bus.connect, waited_s, zenoh_id) from error
        if time.monotonic() - reminded_s > _REMIND_S:
            reminded_s = time.monotonic()
            log.warning("still waiting for a router at %s; start one with 'rpod router'", bus.connect)
        stop.wait(_RETRY_S)


def open_router(config: RouterConfig) -> zenoh.Session:
    """Open a router session. Gossip stays on, so that peers of rmw_zenoh find each other.

    Raises:
        EndpointError: the endpoint is in use or cannot be opened.
    """
    try:
        return zenoh.open(
            _zenoh_config(
                mode="router",
                listen={"endpoints": [config.listen], "exit_on_failure": True},
                connect={
                    "endpoints": list(config.connect),
                    "timeout_ms": -1,  # without end, in the background
                    "exit_on_failure": False,
                    "retry": {"period_init_ms": 100, "period_max_ms": 500},
                },
                scouting={"multicast": {"enabled": False}, "gossip": {"enabled": True}},
                access_control=truth_rules(config),
            )
        )
    except zenoh.ZError as error:
        raise EndpointError(config.listen, str(error).split(" at /")[0]) from error


def truth_rules(config: RouterConfig) -> dict[str, Any]:
    """Return Zenoh access rules that keep the truth from the estimators (ICD section 2).

    The rules hold in every domain and namespace. They name ``@adv`` keys explicitly, because ``**`` does not
    match the verbatim chunks of zenoh.ext's caches.
    """
    if not config.estimators:
        return {"enabled": False}  # Zenoh refuses an empty list of subjects
    keys = [f"*/**/{topic.name}/**" for topic in TRUTH_TOPICS]
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
        "subjects": [{"id": "estimators", "zids": list(config.estimators)}],
        "policies": [{"rules": ["no-truth"], "subjects": ["estimators"]}],
    }


def free_endpoint() -> str:
    """Return an endpoint on loopback that is free at this moment."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"
