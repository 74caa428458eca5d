import time

from rpod_runtime.delivery.inbox import Inbox, Received
from rpod_runtime.health import MOST_NAMES, HealthBook
from rpod_schemas.errors import MessageRejectedError, Reason
from rpod_schemas.rmw.wire import Attachment
from rpod_schemas.topics import TRUTH
from rpod_schemas.types import Health


def received(number, size=0):
    return Received(TRUTH, "k", memoryview(bytes(size)), Attachment(number, 0, bytes(16)), 0)


def test_an_inbox_hands_out_all_in_order_of_arrival():
    inbox = Inbox()
    for number in (1, 2, 3):
        inbox.put(received(number))
    assert [item.attachment.sequence for item in inbox.wait(0.0)] == [1, 2, 3]
    assert inbox.wait(0.0) == []


def test_a_wait_ends_when_it_is_woken_and_the_wake_is_told_once():
    inbox = Inbox()
    inbox.wake()
    assert inbox.wait(timeout_s=60.0) == []
    assert inbox.take_wake()
    assert not inbox.take_wake()


def test_what_does_not_fit_an_inbox_is_counted_and_the_newest_stay():
    inbox = Inbox(capacity=2)
    for number in range(1, 6):
        inbox.put(received(number))
    assert inbox.overflowed == 3
    assert [item.attachment.sequence for item in inbox.wait(0.0)] == [4, 5]
    inbox.put(received(6))
    assert inbox.overflowed == 3


def test_an_inbox_is_bounded_in_bytes_too_and_says_what_it_dropped():
    inbox = Inbox(capacity_bytes=1000)
    assert [inbox.put(received(number, 300)) for number in (1, 2, 3)] == [[], [], []]
    dropped = inbox.put(received(4, 700))
    assert [item.attachment.sequence for item in dropped] == [1, 2]
    assert inbox.overflowed == 2
    assert len(inbox.put(received(5, 5000))) == 2
    assert [item.attachment.sequence for item in inbox.wait(0.0)] == [5]
    assert inbox.put(received(6, 900)) == []


def test_rejections_are_counted_by_topic_and_reason_and_told_each_minute(monkeypatch):
    health = HealthBook("estimator")
    assert health.reject("pmd/depth/image_raw", Reason.LATE)
    assert not health.reject("pmd/depth/image_raw", Reason.LATE)
    assert health.reject("pmd/depth/image_raw", Reason.MALFORMED)
    later_s = time.monotonic() + 61.0
    monkeypatch.setattr(time, "monotonic", lambda: later_s)
    assert health.reject("pmd/depth/image_raw", Reason.MALFORMED)
    assert not health.reject("pmd/depth/image_raw", Reason.MALFORMED)
    counters = health.counters()
    assert counters["rejected/pmd/depth/image_raw/late"] == 2
    assert counters["rejected/pmd/depth/image_raw/malformed"] == 3


def test_a_change_of_health_is_seen_once():
    health = HealthBook("logger")
    health.take_change()
    health.report(Health.ERROR, "disk full")
    assert health.take_change()
    health.report(Health.ERROR, "disk full")
    assert not health.take_change()


def test_a_command_is_told_at_once_and_its_text_stays():
    health = HealthBook("estimator")
    health.take_change()
    health.note_command("reset", "{}")
    health.note_command("reset", '{"frame_id":"chaser"}')
    assert health.take_change()
    assert health.diagnostic(5).values == {
        "commands/reset": "2",
        "command/reset": '{"frame_id":"chaser"}',
    }
    assert health.counters() == {"commands/reset": 2}


def test_a_warning_is_told_at_once_and_stays():
    health = HealthBook("estimator")
    health.report(Health.OK, "tracking")
    health.take_change()
    health.warn("sequence_jump/pmd/depth/image_raw", "5 to 1099511627776, publisher 00ff")
    assert health.take_change()
    health.report(Health.OK, "tracking")
    diagnostic = health.diagnostic(5)
    assert diagnostic.level == Health.WARN
    assert diagnostic.message == "tracking; look at sequence_jump/pmd/depth/image_raw"
    assert diagnostic.values["sequence_jump/pmd/depth/image_raw"] == "5 to 1099511627776, publisher 00ff"
    health.report(Health.ERROR, "disk full")
    assert health.diagnostic(5).level == Health.ERROR


def test_a_diagnostic_carries_level_message_and_counters():
    health = HealthBook("logger")
    health.count("frames/pmd", 3)
    health.report(Health.WARN, "slow disk")
    diagnostic = health.diagnostic(5)
    assert (diagnostic.name, diagnostic.level, diagnostic.message) == ("logger", Health.WARN, "slow disk")
    assert diagnostic.values == {"frames/pmd": "3"}


def test_names_without_end_are_counted_together():
    health = HealthBook("logger")
    health.count("received/clock")
    for number in range(2 * MOST_NAMES):
        health.count(f"received/made-up-{number}")
    health.count("received/clock")
    counters = health.counters()
    assert len(counters) == MOST_NAMES + 1
    assert counters["received/clock"] == 2
    assert counters["received/others"] == MOST_NAMES + 1


def test_a_name_that_an_error_quotes_does_not_make_the_diagnostics_long():
    error = MessageRejectedError(Reason.UNKNOWN_FRAME, f"frame {'x' * 60_000} has no chain")
    health = HealthBook("estimator")
    health.reject("pmd/depth/image_raw", error)
    assert len(health.rejection("pmd/depth/image_raw")) < 1100
    assert error.text.startswith("frame xxx")
    assert len(str(error)) < 1100


def test_an_error_that_quotes_a_message_is_one_line_without_control_characters():
    error = MessageRejectedError(
        Reason.UNKNOWN_FRAME, "frame 'a\n12:00 ERROR logger: lost\x1b[2J' has no chain"
    )
    assert error.text == "frame 'a�12:00 ERROR logger: lost�[2J' has no chain"
