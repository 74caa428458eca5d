"""A flood: what the publisher still has is recovered, the rest is counted, to the last message."""

from time import monotonic

import numpy as np
from live_bus import TIMEOUT_S

from rpod_runtime import Node
from rpod_runtime.delivery.accounting import Count
from rpod_schemas.messages import write_image
from rpod_schemas.rmw.cdr import encode
from rpod_schemas.topics import DEPTH, SENSOR_CACHE

TOPIC = DEPTH.of("pmd")
IMAGE = encode(write_image(0, "", np.zeros((600, 600), np.float32), "32FC1"))
"""Large enough that buffers do not hide the loss."""
FLOOD = 4 * SENSOR_CACHE
ROUNDS = 5


def test_of_a_flood_every_message_is_received_recovered_or_missed(bus):
    sender, receiver = bus.node("sender"), bus.node("receiver")
    got: list[int] = []
    receiver.subscribe_all([TOPIC], lambda received: got.append(received.attachment.sequence))
    publisher = sender.publisher(TOPIC)
    key = receiver.config.bus.keys.key(TOPIC)
    for _ in range(3):  # the first may be history, the next come live
        publisher.put(IMAGE)
        await_all(receiver, key, publisher.published)
    for _ in range(ROUNDS):
        for _ in range(FLOOD):
            publisher.put(IMAGE)
        count = await_all(receiver, key, publisher.published)
        assert count.received + count.missed == publisher.published
        if count.recovered:
            break
    assert count.recovered
    assert count.received == len(got)
    assert got == sorted(set(got))


def await_all(receiver: Node, key: str, messages: int) -> Count:
    """Return the account once it is settled: a query whose answer is lost too is given up after seconds."""
    deadline_s = monotonic() + 3 * TIMEOUT_S
    while True:
        count = receiver.account.counts[key]
        if count.received + count.missed >= messages or monotonic() > deadline_s:
            return count
        receiver.stop.wait(0.05)
