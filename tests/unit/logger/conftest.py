"""Messages as they come off the wire, without a wire."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from logger_desk import Desk

from rpod_runtime import Received
from rpod_schemas.messages import write_clock, write_transforms
from rpod_schemas.poses import make_pose
from rpod_schemas.rmw.cdr import encode
from rpod_schemas.rmw.wire import UNNUMBERED, Attachment
from rpod_schemas.topics import CLOCK, TF_STATIC, Namespace, Topic

KEYS = Namespace()
ARRIVAL_NS = 1_700_000_000_000_000_000

Arrive = Callable[..., Received]


def _payload(topic: Topic, number: int) -> bytes:
    if topic == TF_STATIC:
        pose = make_pose(translation_m=(float(number), 0.0, 0.0))
        return bytes(encode(write_transforms(number, [("chaser", "pmd", pose)])))
    return bytes(encode(write_clock(number)))


@pytest.fixture
def arrive() -> Arrive:
    """Return a maker of received messages: topic, sequence number, optionally payload and gid."""

    def make(
        topic: Topic = CLOCK, number: int = 1, *, payload: bytes | None = None, gid: bytes = b"g" * 16
    ) -> Received:
        data = _payload(topic, number) if payload is None else payload
        key = KEYS.key(topic) if topic.type else topic.name
        stamp_ns = ARRIVAL_NS + number
        attachment = Attachment(number, stamp_ns, gid) if topic.type or number else UNNUMBERED
        return Received(topic, key, memoryview(data), attachment, stamp_ns + 500)

    return make


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Callable[..., Desk]]:
    """Return a maker of recorders that end with the test: settings, optionally the directory."""
    with ExitStack() as stack:

        def make(directory: Path = tmp_path, **settings: Any) -> Desk:
            desk = Desk(directory, **settings)
            stack.enter_context(desk.recorder)
            return desk

        yield make
