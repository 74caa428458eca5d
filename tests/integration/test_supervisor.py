"""The supervisor with real processes: routers, since they start fastest."""

import signal

import psutil
import pytest
from facility_process import until

from rpod.errors import ServiceDiedError
from rpod.play import supervisor
from rpod.play.supervisor import Supervisor
from rpod_runtime.bus.session import free_endpoint
from rpod_schemas.config.service import RouterConfig

ELSEWHERE = "tcp/192.0.2.1:7447"
"""An address that no machine has (RFC 5737), so that a router cannot listen there."""


def start(services: Supervisor, listen: str = "") -> psutil.Process:
    before = set(psutil.Process().children())
    services.start("router", RouterConfig(listen=listen or free_endpoint()))
    (process,) = set(psutil.Process().children()) - before
    return process


@pytest.fixture
def said():
    return []


@pytest.fixture
def services(tmp_path, said):
    return Supervisor(tmp_path, said.append)


def test_on_leaving_what_runs_is_stopped_and_its_configuration_is_kept(services, said, tmp_path):
    with services:
        router = start(services)
        services.check()
    assert said == ["stopping router"]
    assert not router.is_running()
    RouterConfig.model_validate_json((tmp_path / "config" / "router.json").read_text("utf-8"))


def test_a_service_that_ends_early_is_named_with_its_exit_code_and_last_lines(services):
    with services:
        start(services, ELSEWHERE)
        with pytest.raises(ServiceDiedError, match="service router ended with exit code 1") as died:
            until(services.check)
    assert died.value.name == "router"
    assert ELSEWHERE in str(died.value)
    assert "router.log" in str(died.value)


def test_a_service_that_does_not_stop_is_ended_by_force_and_that_is_an_error(services, monkeypatch):
    monkeypatch.setattr(supervisor, "_STOP_TIMEOUT_S", 0.1)
    with services:
        router = start(services)
        until(lambda: "ready" in services.log_of("router").read_text("utf-8"))  # before, any signal ends it
        router.suspend()
        with pytest.raises(ServiceDiedError, match="router was killed by signal 9"):
            services.stop("router")
    assert not router.is_running()


def test_after_a_second_interrupt_nobody_is_waited_for(services, said):
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job ignores it

    def interrupted_again() -> None:
        with services:
            start(services)
            signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        interrupted_again()
    assert not said
    services.check()
    services.stop("router")


def test_an_optional_service_may_end_as_it_likes_and_that_is_said_once(services, caplog):
    with services:
        services.start("router", RouterConfig(listen=ELSEWHERE), optional=True)
        until(lambda: services.check() or caplog.messages)
        assert "service router ended with exit code 1" in caplog.text
        assert "the run goes on without router" in caplog.text
        services.check()
        services.stop("router")
    assert len(caplog.messages) == 1
