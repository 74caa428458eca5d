"""How a link between a service and the router is tuned, by name or field by field.

The names of Zenoh's own settings stand with each field; its defaults are for fast networks.
"""

from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from rpod_schemas.config.base import Config, Positive


class LinkConfig(Config):
    """Tuning of one side's links. Each side tunes what it sends: give both sides the same values."""

    lease_s: float = Field(default=10.0, ge=0.5, le=60.0)
    """Time without a sign of life after which the other side takes the link as gone, s
    (``transport/link/tx/lease``); four signs are sent in it. A process that stands still for longer loses its
    link."""
    open_timeout_s: float = Field(default=10.0, ge=0.1, le=60.0)
    """Longest time that a connection takes until it is ready, s (``transport/unicast/open_timeout``). A
    client whose attempt was lost tries again after it."""
    send_buffer_bytes: int | None = Field(default=None, ge=4096, le=1 << 26)
    """Size of the system's send buffer (``transport/link/tcp/so_sndbuf``); the system's own choice, which
    grows to megabytes, if left out. What waits in it cannot be dropped any more, and grows old."""
    queued_batches: int = Field(default=16, ge=1, le=16)
    """Number of batches of 64 KiB that wait for a busy link, for bulky and for small messages each
    (``queue/size``)."""
    wait_fragments_s: Positive = 0.05
    """Longest time that a large message which was begun waits for room, s
    (``congestion_control/drop/max_wait_before_drop_fragments``); then it is dropped, although part of it was
    sent."""
    newest_large: bool = False
    """Whether a large message waits for room however long, while newer ones of its priority are dropped
    (``qos/network``, congestion control ``block_first``). A receiver that stands still then holds up the
    router, and after 5 s publishers' links are closed: not for a router with other clients."""
    large_bytes: int = Field(default=32_768, ge=1)
    """Size from which a message is large, bytes."""
    compression: bool = False
    """Whether each batch is compressed with LZ4 (``transport/unicast/compression``); both sides have to."""


SLOW: dict[str, Any] = {
    "lease_s": 4.0,
    "open_timeout_s": 1.0,
    "send_buffer_bytes": 65_536,
}
"""A link of some megabits a second that may be interrupted. What the system holds is sent in 0.1 s at
10 Mbit/s; a lost link is noticed in 4 s, and an attempt to open one is repeated after 1 s."""
PROFILES: dict[str, dict[str, Any]] = {"fast": {}, "slow": SLOW}


def _profile(value: Any) -> Any:
    if not isinstance(value, str):
        return value
    if value not in PROFILES:
        raise ValueError(f"is {value!r}, needs {' or '.join(PROFILES)}, or fields")
    return PROFILES[value]


Link = Annotated[LinkConfig, BeforeValidator(_profile)]
"""A link: ``fast``, ``slow``, or its fields."""
