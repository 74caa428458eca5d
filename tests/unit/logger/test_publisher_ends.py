"""Who said the last number, and who did not; without a bus."""

from collections.abc import Callable

import pytest

from rpod_logger.publisher_ends import GRACE_S, RETURN_S, PublisherEnds
from rpod_runtime import Received
from rpod_runtime.bus.link import Link
from rpod_runtime.health import HealthBook
from rpod_schemas.control import StatusReply
from rpod_schemas.messages import write_diagnostics
from rpod_schemas.rmw.cdr import encode
from rpod_schemas.rmw.wire import Attachment
from rpod_schemas.topics import CLOCK, DIAGNOSTICS, Topic
from rpod_schemas.types import Diagnostic, Health

NS = 10**9
OTHER = Topic("lab/other", "std_msgs/msg/String")


class Stage:
    """A service named motion in session ``s`` with a publisher of ``clock``; time goes as the test says."""

    def __init__(self) -> None:
        self.link = Link(HealthBook("logger"), "tcp/router")
        self.link.note("r", opened=True, now_ns=0)
        self.ends = PublisherEnds(lambda topic: topic != OTHER, self.link, own="logger")
        self.now_s = 100.0
        self._beats = 0

    def begin(self, session: str = "s") -> None:
        for topic in (DIAGNOSTICS, CLOCK, OTHER):
            self.ends.came(session, topic)

    def clock(self, number: int, *, session: str = "s", gid: bytes = b"c" * 16) -> None:
        self._hear(CLOCK, b"", Attachment(number, 0, gid), session)

    def beat(self, session: str = "s", *, closing: bool = False, **published: int) -> None:
        values = {f"published/{name}": str(count) for name, count in published.items()}
        values |= {"closing": "true"} if closing else {}
        diagnostic = Diagnostic(stamp_ns=1, name="motion", level=Health.OK, message="", values=values)
        self._beats += 1
        payload = bytes(encode(write_diagnostics([diagnostic])))
        self._hear(DIAGNOSTICS, payload, Attachment(self._beats, 0, b"d" * 16), session)

    def _hear(self, topic: Topic, payload: bytes, attachment: Attachment, session: str) -> None:
        received = Received(
            topic, topic.name, memoryview(payload), attachment, 0, arrival_s=self.now_s, session=session
        )
        self.ends.receive(received)

    def leave(self, session: str = "s") -> None:
        for topic in (CLOCK, DIAGNOSTICS):
            self.ends.gone(session, topic, now_s=self.now_s, now_ns=round(self.now_s * NS))

    def answer(self, **published: int) -> None:
        counters = {f"published/{name}": count for name, count in published.items()}
        status = StatusReply(
            name="motion", version="1", state="ready", uptime_s=1.0, counters=counters, configuration={}
        )
        self.ends.confirm([status], now_s=self.now_s)

    def reasons(self, after_s: float = 2 * GRACE_S) -> tuple[str, ...]:
        self.decide_for(after_s)
        return self.ends.take(0).reasons

    def decide_for(self, duration_s: float) -> None:
        """Decide four times a second from now on, as the logger does."""
        for turn in range(round(4 * duration_s) + 1):
            self.ends.decide(self.now_s + turn / 4)


@pytest.fixture
def stage() -> Stage:
    stage = Stage()
    stage.begin()
    stage.clock(1)
    stage.beat(clock=1)
    return stage


def test_who_said_the_last_number_and_whose_messages_came_leaves_nothing_to_tell(stage):
    stage.clock(2)
    stage.beat(clock=2, closing=True, other=9)
    stage.leave()
    assert stage.reasons(0.0) == ()


@pytest.mark.parametrize(
    ("end", "says"),
    [
        (
            lambda _: None,
            "motion (session s, gid 64646464646464646464646464646464) ended at 1970-01-01T00:01:40",
        ),
        (lambda stage: stage.beat(clock=3), "without saying its last numbers"),
        (lambda stage: stage.beat(clock=3, closing=True), "; clock: 3 published, 1 arrived"),
    ],
    ids=["no word", "a word that is not the last", "the last message did not come"],
)
def test_who_ends_otherwise_is_named(stage, end: Callable[[Stage], None], says):
    end(stage)
    stage.leave()
    assert stage.reasons(0.5 * GRACE_S) == (), "it may still come"
    (reason,) = stage.reasons()
    assert says in reason
    assert stage.reasons() == (), "told once"


def test_a_last_word_may_come_after_the_token_is_gone_but_not_after_the_decision(stage):
    stage.leave()
    stage.beat(clock=1, closing=True)
    assert stage.reasons() == ()


def test_two_publishers_of_a_topic_in_one_session_are_added(stage):
    stage.clock(4, gid=b"e" * 16)
    stage.beat(clock=5, closing=True)
    stage.leave()
    assert stage.reasons() == ()


def test_what_was_published_before_the_logger_came_is_not_missing():
    stage = Stage()
    stage.begin()
    stage.beat(clock=1000)
    stage.beat(clock=1000, closing=True)
    stage.leave()
    assert stage.reasons() == ()


def test_a_service_that_is_there_at_the_close_has_to_answer(stage):
    since_s = stage.now_s + 1.0
    stage.ends.conclude(since_s)
    assert "did not answer at the close" in stage.reasons()[0]
    stage.now_s += 2.0
    stage.answer(clock=3)
    assert stage.ends.is_open(since_s)
    stage.clock(3)
    assert not stage.ends.is_open(since_s)
    stage.ends.conclude(since_s)
    assert stage.reasons() == ()


def test_what_is_missing_at_a_close_is_told_of_one_file_only(stage):
    stage.answer(clock=3)
    stage.ends.conclude(stage.now_s)
    assert stage.reasons()[0].endswith(", at the close: clock: 3 published, 1 arrived")
    stage.answer(clock=3)
    stage.ends.conclude(stage.now_s)
    assert stage.reasons() == ()


def test_who_vanished_with_the_bus_has_time_to_come_back(stage):
    stage.link.note("r", opened=False, now_ns=round(stage.now_s * NS))
    stage.leave()
    assert not stage.ends.is_open(stage.now_s), "nobody is waited for while the bus is lost"
    stage.ends.decide(stage.now_s + 100.0)
    stage.link.note("q", opened=True, now_ns=round((stage.now_s + 3.0) * NS))
    stage.now_s += 100.0
    (lost,) = stage.reasons(1.0)
    assert lost == "the bus was lost: 1970-01-01T00:01:40.000Z to 1970-01-01T00:01:43.000Z (3.0 s)"
    stage.now_s += 1.0 + 2.0 * RETURN_S
    assert len(stage.reasons(0.0)) == 1, "this process stood still: who came back is not handled yet"
    _, ended = stage.reasons(RETURN_S)
    assert "without saying its last numbers" in ended


def test_who_comes_back_after_the_bus_was_lost_has_not_ended(stage):
    stage.link.note("r", opened=False, now_ns=round(stage.now_s * NS))
    stage.leave()
    stage.link.note("r", opened=True, now_ns=round((stage.now_s + 1.0) * NS))
    stage.begin()
    stage.ends.decide(stage.now_s + 100.0)
    assert len(stage.ends.take(0).reasons) == 1
    assert stage.ends.take(round((stage.now_s + 2.0) * NS)).reasons == (), "of a file begun after it"


def test_a_process_that_stood_still_waits_for_the_messages_of_that_time(stage):
    stage.ends.decide(stage.now_s)
    stage.leave()
    stage.now_s += 30.0
    assert stage.reasons(after_s=0.5) == (), "the last messages came while it stood still, and wait"
    stage.clock(2)
    stage.beat(clock=2, closing=True)
    assert stage.reasons() == ()


def test_other_software_is_told_and_is_no_reason(stage):
    stage.begin("foreign")
    stage.clock(7, session="foreign")
    stage.leave("foreign")
    stage.decide_for(2 * GRACE_S)
    endings = stage.ends.take(0)
    assert endings.reasons == ()
    assert "clock: a publisher of session foreign ended" in endings.unconfirmed[0]
    assert endings.unconfirmed[0].endswith("the last that arrived is 7")


def test_a_flood_of_sessions_pushes_out_no_service(stage):
    for number in range(3000):
        stage.clock(1, session=f"flood{number}")
    stage.leave()
    (reason,) = stage.reasons()
    assert "without saying its last numbers" in reason
