"""The recorder without a bus: files, counts, commands, and a disk that fails."""

import errno
import json
import threading
from contextlib import ExitStack
from pathlib import Path

import pytest
from mcap.reader import make_reader

from rpod_logger.errors import AlreadyRecordingError, CannotWriteError, NotRecordingError
from rpod_logger.recorder import Recorder
from rpod_logger.writer import LogFile
from rpod_runtime.accounting import SequenceAccount
from rpod_runtime.health import HealthBook
from rpod_schemas.config.logger import LoggerConfig
from rpod_schemas.control import StatusReply
from rpod_schemas.logs import TopicCount
from rpod_schemas.topics import CLOCK, TF_STATIC, Topic
from rpod_schemas.types import Health

BIG = Topic("lab/big", "")


class Desk:
    """A recorder with its health and account, as the daemon would have them."""

    def __init__(self, directory: Path, **settings: object) -> None:
        self.health = HealthBook("logger")
        self.account = SequenceAccount()
        config = LoggerConfig(directory=directory, name="run", **settings)
        self.recorder = Recorder(config, version="1.2.3", health=self.health, account=self.account)

    def put(self, received) -> None:
        self.account.take(received.key, received.attachment)
        self.recorder.put(received)


@pytest.fixture
def desk(tmp_path):
    with ExitStack() as stack:

        def open_desk(**settings: object) -> Desk:
            desk = Desk(tmp_path, **settings)
            stack.enter_context(desk.recorder)
            return desk

        yield open_desk


def read(path: Path | str) -> list[tuple[str, int]]:
    with Path(path).open("rb") as stream:
        return [
            (channel.topic, message.sequence)
            for _, channel, message in make_reader(stream).iter_messages(log_time_order=False)
        ]


def metadata(path: Path | str, name: str) -> dict[str, str]:
    with Path(path).open("rb") as stream:
        found = [item.metadata for item in make_reader(stream).iter_metadata() if item.name == name]
    return found[-1] if found else {}


def counts(path: Path | str) -> dict[str, TopicCount]:
    return {topic: TopicCount.model_validate_json(text) for topic, text in metadata(path, "counts").items()}


def test_counts_tell_what_was_received_written_missed_and_doubled(desk, arrive):
    one = desk()
    one.recorder.start()
    for number in (1, 2, 5, 6):
        one.put(arrive(CLOCK, number))
    one.account.take(arrive(CLOCK, 6).key, arrive(CLOCK, 6).attachment)
    closed = one.recorder.stop()
    assert counts(closed.path) == {"/clock": TopicCount(received=4, written=4, missed=2, duplicates=1)}
    assert closed.messages == len(read(closed.path)) == 4


def test_a_split_loses_and_doubles_nothing_and_counts_each_file_for_itself(desk, arrive):
    one = desk()
    first = one.recorder.start()
    for number in range(1, 8):
        one.put(arrive(CLOCK, number))
    second = one.recorder.split()
    for number in range(8, 12):
        one.put(arrive(CLOCK, number))
    one.recorder.stop()
    assert Path(second.path).name == "run-2.mcap"
    assert read(first.path) == [("/clock", number) for number in range(1, 8)]
    assert read(second.path) == [("/clock", number) for number in range(8, 12)]
    assert [counts(log.path)["/clock"].received for log in (first, second)] == [7, 4]


def test_every_file_opens_with_the_last_latched_message_of_each_publisher(desk, arrive):
    one = desk()
    one.recorder.start()
    one.put(arrive(TF_STATIC, 1))
    one.put(arrive(TF_STATIC, 2))
    one.put(arrive(TF_STATIC, 1, gid=b"h" * 16))
    one.put(arrive(CLOCK, 1))
    second = one.recorder.split("later")
    one.put(arrive(CLOCK, 2))
    one.recorder.stop()
    assert read(second.path) == [("/tf_static", 2), ("/tf_static", 1), ("/clock", 2)]
    assert counts(second.path)["/tf_static"] == TopicCount(repeated=2)


def test_what_came_while_nothing_was_recorded_is_in_no_file_but_its_latched_messages_are(desk, arrive):
    one = desk()
    one.put(arrive(TF_STATIC, 1))
    one.put(arrive(CLOCK, 1))
    log = one.recorder.start()
    one.put(arrive(CLOCK, 2))
    one.recorder.stop()
    assert read(log.path) == [("/tf_static", 1), ("/clock", 2)]
    assert counts(log.path)["/clock"] == TopicCount(received=1, written=1)


def test_what_does_not_fit_is_lost_loudly_and_counted(desk, arrive, monkeypatch, caplog):
    disk_is_free = threading.Event()
    write = LogFile.write

    def write_late(self, received):
        assert disk_is_free.wait(10)
        write(self, received)

    monkeypatch.setattr(LogFile, "write", write_late)
    one = desk(queue_bytes=1 << 20)
    log = one.recorder.start()
    for number in range(1, 41):
        one.put(arrive(BIG, number, payload=bytes(100_000)))
    one.recorder.tell_losses()
    level, message = one.recorder.check()
    disk_is_free.set()
    closed = one.recorder.stop()
    count = counts(log.path)["/lab/big"]
    assert count.received == 40
    assert 10 <= count.written == closed.messages <= 12  # the queue's, and one in the writer's hands
    assert one.health.counters()["lost/lab/big"] == count.lost == 40 - count.written
    assert level is Health.ERROR
    assert f"{count.lost} lost here" in message
    assert [record.levelname for record in caplog.records] == ["ERROR"]
    assert 900_000 < one.health.counters()["queue/high_water_bytes"] <= 1 << 20


def test_a_full_disk_is_an_error_and_a_new_log_can_be_started_later(desk, arrive, monkeypatch, caplog):
    one = desk()
    first = one.recorder.start()
    one.put(arrive(CLOCK, 1))
    write = LogFile.write

    def full(self, received):
        if received.attachment.sequence in (2, 3):
            raise OSError(errno.ENOSPC, "No space left on device")
        write(self, received)

    monkeypatch.setattr(LogFile, "write", full)
    one.put(arrive(CLOCK, 2))
    one.put(arrive(CLOCK, 3))
    with pytest.raises(NotRecordingError):
        one.recorder.stop()
    assert one.recorder.check() == (Health.ERROR, f"cannot write {first.path}: No space left on device")
    assert one.health.counters()["lost/clock"] == 2
    second = one.recorder.start()
    one.put(arrive(CLOCK, 4))
    one.recorder.stop()
    assert read(second.path) == [("/clock", 4)]
    assert one.recorder.check() == (Health.ERROR, "not recording; 2 lost here, 0 missed on the bus")
    assert [record.levelname for record in caplog.records] == ["ERROR"]


def test_a_failing_close_is_told_to_who_asked(desk, arrive, monkeypatch):
    def fail(_):
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(LogFile, "close", fail)
    one = desk()
    one.recorder.start()
    one.put(arrive(CLOCK, 1))
    with pytest.raises(CannotWriteError, match="Input/output error"):
        one.recorder.stop()


def test_the_log_is_finished_when_the_recorder_ends(tmp_path, arrive):
    desk = Desk(tmp_path)
    with desk.recorder:
        log = desk.recorder.start()
        for number in range(1, 101):
            desk.put(arrive(CLOCK, number))
    assert len(read(log.path)) == 100
    assert counts(log.path)["/clock"].written == 100
    with pytest.raises(NotRecordingError):
        desk.recorder.stop()


def test_start_is_refused_while_recording_and_stop_while_not(desk):
    one = desk()
    one.recorder.start()
    with pytest.raises(AlreadyRecordingError, match="use split"):
        one.recorder.start()
    one.recorder.stop()
    with pytest.raises(NotRecordingError):
        one.recorder.stop()


def test_a_directory_that_cannot_be_made_is_told_to_who_asked(desk, tmp_path):
    one = desk()
    (tmp_path / "file").touch()
    blocked = Desk(tmp_path / "file" / "below")
    with blocked.recorder, pytest.raises(CannotWriteError, match="below"):
        blocked.recorder.start()
    assert one.recorder.check() == (Health.OK, "not recording")


def test_configuration_software_and_target_of_the_services_are_in_the_log(desk):
    one = desk()
    log = one.recorder.start()
    one.recorder.know([status("emulator", seed=1), status("motion", rate_hz=250.0)])
    one.recorder.know([status("emulator", seed=2)])
    one.recorder.stop()
    configuration = metadata(log.path, "configuration")
    assert json.loads(configuration["emulator"]) == {"seed": 2}
    assert json.loads(configuration["motion"]) == {"rate_hz": 250.0}
    assert metadata(log.path, "software") == {"name": "rpod", "version": "1.2.3", "target_digest": "abc"}
    assert json.loads(metadata(log.path, "status")["emulator"])["counters"] == {"frames": 3}


def status(name: str, **configuration: object) -> StatusReply:
    return StatusReply(
        name=name,
        version="1.2.3",
        state="ready",
        uptime_s=1.0,
        counters={"frames": 3},
        configuration=configuration,
        target_digest="abc" if name == "emulator" else None,
    )
