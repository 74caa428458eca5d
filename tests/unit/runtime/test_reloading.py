"""A file that is read again: what may change changes, what may not is named with the remedy."""

import logging

import pytest

from rpod_runtime.errors import RefusedError
from rpod_runtime.process.reloading import Reloader, describe
from rpod_schemas.config.base import live_fields
from rpod_schemas.config.emulator import EmulatorConfig, MotionServiceConfig
from rpod_schemas.config.estimator import EstimatorConfig, PmdInput
from rpod_schemas.config.facility.logger import LoggerConfig
from rpod_schemas.config.service import BusConfig, RouterConfig
from rpod_schemas.errors import ConfigurationError
from rpod_security.errors import AuditError


@pytest.fixture(autouse=True)
def _level():
    before = logging.getLogger().level
    yield
    logging.getLogger().setLevel(before)


class File:
    """A configuration file, by what is in it now."""

    def __init__(self, config):
        self.now, self.told = config, []
        self.reloader = Reloader()
        self.reloader.begin(config, self._read)
        self.reloader.on_change(lambda config, reply: self.told.append((config, reply)))

    def _read(self):
        if isinstance(self.now, Exception):
            raise self.now
        return self.now

    def write(self, **changes):
        self.now = self.now.model_copy(update=changes)
        return self.reloader.reload()


def test_what_may_change_is_in_force_and_told():
    file = File(LoggerConfig())
    reply = file.write(log_level="error", split_bytes=1 << 20, sync_interval_s=2.0)
    assert reply.changed == {"log_level": "error", "split_bytes": 1 << 20, "sync_interval_s": 2.0}
    assert reply.needs_restart == ()
    assert logging.getLogger().level == logging.ERROR
    ((config, told),) = file.told
    assert (config, told) == (file.now, reply)
    assert file.write().changed == {}, "what was taken is not new a second time"


def test_what_may_not_change_is_named_with_its_place_and_the_remedy(caplog):
    file = File(LoggerConfig())
    reply = file.write(compression="zstd", bus=BusConfig(domain=3), split_bytes=1 << 20)
    assert reply.changed == {"split_bytes": 1 << 20}
    assert reply.needs_restart == ("bus.domain", "compression")
    config, _ = file.told[0]
    assert (config.compression, config.bus.domain, config.split_bytes) == ("lz4", 0, 1 << 20)
    assert (
        "cannot change while it runs: bus.domain, compression; restart the service, or correct"
        in describe(reply)
    )
    assert "split_bytes is 1048576" in caplog.text
    assert file.write().needs_restart == ("bus.domain", "compression"), "until it is mended"
    assert file.write(compression="lz4", bus=BusConfig()).needs_restart == ()


def test_a_wrong_file_changes_nothing():
    file = File(LoggerConfig())
    file.now = ConfigurationError("logger.yaml", "split_bytes", "is too small")
    with pytest.raises(ConfigurationError):
        file.reloader.reload()
    assert file.told == []


def test_a_reading_that_cannot_be_recorded_changes_nothing():
    file = File(LoggerConfig())

    def refuse(*_):
        raise AuditError("no room")

    file.reloader._listeners.insert(0, refuse)
    with pytest.raises(AuditError):
        file.write(split_bytes=1 << 20)
    file.reloader._listeners.remove(refuse)
    assert file.told == []
    assert file.reloader.reload().changed == {"split_bytes": 1 << 20}


def test_without_a_file_there_is_nothing_to_read_again():
    reloader = Reloader()
    reloader.begin(LoggerConfig(), None)
    with pytest.raises(RefusedError, match="without a configuration file"):
        reloader.reload()


@pytest.mark.parametrize(
    "model",
    [EstimatorConfig, EmulatorConfig, MotionServiceConfig, RouterConfig],
    ids=lambda one: one.__name__,
)
def test_nothing_changes_on_which_messages_depend(model):
    """A log has one configuration of each service, by which it is replayed."""
    assert live_fields(model) == ("log_level",)


def test_the_tracking_of_an_estimator_is_named_where_it_stands():
    file = File(EstimatorConfig(target="mockup", sensors=(PmdInput(),)))
    navigator = file.now.navigator.model_copy(update={"silence_timeout_s": 9.0})
    assert file.write(navigator=navigator).needs_restart == ("navigator.silence_timeout_s",)
