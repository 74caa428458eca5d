"""What a service tells its service manager, read from a socket as systemd reads it."""

import os
import socket
from threading import Event, Thread

import pytest
from live_bus import TIMEOUT_S

from rpod_runtime.process.notify import ServiceManager


@pytest.fixture
def listener(tmp_path, monkeypatch):
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as link:
        link.bind(str(tmp_path / "notify"))
        link.settimeout(TIMEOUT_S)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        monkeypatch.setenv("WATCHDOG_USEC", "20000")
        monkeypatch.delenv("WATCHDOG_PID", raising=False)
        yield link


def silent(link):
    link.setblocking(False)
    with pytest.raises(BlockingIOError):
        link.recv(100)


def test_ready_and_what_it_does_are_one_datagram_of_lines(listener):
    ServiceManager().ready("listening\nto pmd")
    assert listener.recv(1000) == b"READY=1\nSTATUS=listening to pmd"


def test_an_abstract_socket_is_written_with_an_at_sign(monkeypatch):
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as link:
        link.bind(f"\0rpod-test-{os.getpid()}")
        link.settimeout(TIMEOUT_S)
        monkeypatch.setenv("NOTIFY_SOCKET", f"@rpod-test-{os.getpid()}")
        ServiceManager().stopping()
        assert link.recv(100) == b"STOPPING=1"


def test_a_main_loop_tells_that_it_lives_as_long_as_it_turns_and_not_when_it_hangs(listener):
    manager, stop = ServiceManager(), Event()
    loop = Thread(target=manager.attend, args=(stop,))
    loop.start()
    try:
        assert [listener.recv(100) for _ in range(2)] == [b"WATCHDOG=1"] * 2
    finally:
        stop.set()
        loop.join(TIMEOUT_S)
    listener.setblocking(False)
    while True:  # what came until the loop ended
        try:
            listener.recv(100)
        except BlockingIOError:
            break
    listener.settimeout(0.1)  # five times the limit: nobody else tells it
    with pytest.raises(TimeoutError):
        listener.recv(100)


def test_a_loop_that_turns_fast_does_not_flood_the_manager(listener, monkeypatch):
    monkeypatch.setenv("WATCHDOG_USEC", "60000000")
    manager = ServiceManager()
    for _ in range(100):
        manager.alive()
    assert listener.recv(100) == b"WATCHDOG=1"
    silent(listener)


def test_the_watchdog_of_another_process_is_not_answered(listener, monkeypatch):
    monkeypatch.setenv("WATCHDOG_PID", str(os.getpid() + 1))
    ServiceManager().alive()
    silent(listener)


def test_without_a_manager_and_with_one_that_is_gone_nothing_happens(tmp_path, monkeypatch):
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    ServiceManager().ready("alone")
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "none"))
    ServiceManager().ready("alone")
