"""What Delivery makes of samples of the bus; samples are made by hand, and no bus is needed."""

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import pytest

from rpod_runtime import Received
from rpod_runtime.delivery import receiving
from rpod_runtime.delivery.accounting import MOST_KEYS, SequenceAccount
from rpod_runtime.delivery.holders import SILENT_S
from rpod_runtime.delivery.receiving import LONGEST_KEY, Delivery
from rpod_runtime.delivery.sources import MOST_GIDS, SecondSourceError, Sources
from rpod_runtime.health import HealthBook
from rpod_schemas.rmw.wire import Attachment
from rpod_schemas.topics import CLOCK, DEPTH, Namespace, Topic

KEYS = Namespace()
GID, OTHER = b"g" * 16, b"o" * 16


class Raw(bytes):
    def to_bytes(self) -> bytes:
        return bytes(self)


@dataclass
class Sample:
    """A sample as Zenoh has it."""

    key_expr: str
    payload: Raw
    attachment: Raw | None
    source_info: Any = None
    congestion_control: Any = None
    encoding: str = ""


def sample(
    number: int, *, topic: Topic = CLOCK, session: str = "", gid: bytes = GID, size: int = 4
) -> Sample:
    source = SimpleNamespace(source_id=SimpleNamespace(zid=session)) if session else None
    attachment = Raw(Attachment(number, 0, gid).pack())
    return Sample(KEYS.key(topic), Raw(size), attachment, source_info=source)


class Desk:
    def __init__(self) -> None:
        self.health, self.account = HealthBook("receiver"), SequenceAccount()
        self.delivery = Delivery(KEYS, self.health, self.account)
        self.got: list[Received] = []

    def take(self, each: Sample, topic: Topic = CLOCK) -> None:
        self.delivery.take(topic, each, self.got.append)

    @property
    def numbers(self) -> list[int]:
        return [received.attachment.sequence for received in self.got]


def test_a_second_session_under_a_gid_takes_nothing_from_the_first_and_is_told():
    desk = Desk()
    for number in (1, 2):
        desk.take(sample(number, session="a1"))
    for number in (3, 800, 1001):
        desk.take(sample(number, session="b2"))
        desk.take(sample(number))
    for number in (3, 4):
        desk.take(sample(number, session="a1"))
    assert desk.numbers == [1, 2, 3, 4]
    assert {received.session for received in desk.got} == {"a1"}
    assert desk.health.counters()["rejected/clock/second_source"] == 6
    assert desk.account.counts[KEYS.key(CLOCK)].missed == 0
    told = desk.health.diagnostic(1).values["second_source/clock"]
    assert GID.hex() in told
    assert "a1" in told


def test_a_session_that_names_none_keeps_its_gid_too():
    desk = Desk()
    desk.take(sample(1))
    desk.take(sample(500, session="b2"))
    desk.take(sample(2))
    assert desk.numbers == [1, 2]


def test_a_gid_is_taken_over_after_a_silence_and_its_numbers_begin_anew():
    sources = Sources()
    assert sources.admit(GID, "a1", 0.0)
    assert not sources.admit(GID, "a1", 1.0)
    with pytest.raises(SecondSourceError):
        sources.admit(GID, "b2", 1.0 + SILENT_S)
    assert sources.admit(GID, "b2", 1.1 + SILENT_S)
    account = SequenceAccount()
    account.take("k", Attachment(700, 0, GID))
    account.restart("k", GID)
    account.take("k", Attachment(1, 0, GID))
    assert (account.counts["k"].received, account.counts["k"].duplicates) == (2, 0)


def test_gids_without_end_push_out_the_silent_ones_only():
    sources = Sources()
    for number in range(2 * MOST_GIDS):
        sources.admit(number.to_bytes(16, "big"), "liar", 0.0)
        sources.admit(GID, "a1", 0.0)
    with pytest.raises(SecondSourceError):
        sources.admit(GID, "liar", 0.0)


def test_the_name_of_a_key_that_is_too_long_stands_nowhere():
    desk, pattern = Desk(), DEPTH.under("*")
    for number in range(20):
        name = f"{number}{'x' * LONGEST_KEY}"
        desk.take(sample(1, topic=DEPTH.of(name), gid=bytes([number] * 16)), pattern)
    desk.take(sample(1, topic=DEPTH.of("pmd")), pattern)
    assert [received.topic.name for received in desk.got] == ["pmd/depth/image_raw"]
    assert desk.health.counters() == {"rejected/others/too_long": 20}


def test_a_message_beyond_any_of_its_type_is_refused_and_a_large_image_is_not(monkeypatch):
    monkeypatch.setattr(receiving, "MOST_BYTES", 1000)
    desk = Desk()
    desk.take(sample(1, size=1001))
    desk.take(sample(2, size=1000))
    image = DEPTH.of("pmd")
    desk.take(sample(1, topic=image, size=5000), image)
    assert desk.numbers == [2, 1]
    assert desk.health.counters() == {"rejected/clock/too_long": 1}


def test_keys_without_end_whose_messages_have_no_number_are_refused():
    desk = Desk()
    for number in range(MOST_KEYS + 50):
        for _ in range(2):
            desk.delivery.take_any(Sample(f"lab/raw/{number}", Raw(b"x"), None), desk.got.append)
    assert len(desk.got) == 2 * MOST_KEYS
    assert desk.health.counters() == {"rejected/others/too_many": 100}
