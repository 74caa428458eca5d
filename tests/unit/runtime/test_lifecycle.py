"""A process that runs a service's body: how signals, its supervisor and its errors end it."""

import os
import signal
import subprocess
import sys

import pytest

from rpod_runtime.process.lifecycle import SUPERVISED

TIMEOUT_S = 30.0
BODY = """
import signal, sys
from threading import Event
from rpod_runtime.process import lifecycle
from rpod_runtime.errors import EndpointError, NoRouterError
from rpod_schemas.errors import ConfigurationError

def body(stop):
    {body}

sys.exit(lifecycle.run("test", body))
"""


def serve(body: str, **changes) -> subprocess.Popen[str]:
    """Start a process with a body that prints when it may be disturbed."""
    return subprocess.Popen(
        [sys.executable, "-c", BODY.format(body=body)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | changes,
    )


def end(process: subprocess.Popen[str]) -> tuple[int, str]:
    try:
        _, said = process.communicate(timeout=TIMEOUT_S)
    finally:
        process.kill()
        process.wait()
    return process.returncode, said


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_first_signal_lets_the_body_finish(number):
    process = serve("print('on', flush=True); stop.wait(); print('off', flush=True)")
    assert process.stdout.readline() == "on\n"
    process.send_signal(number)
    assert process.stdout.readline() == "off\n"
    code, said = end(process)
    assert code == 0
    assert "stopped" in said


def test_a_signal_is_heeded_while_the_main_thread_holds_the_lock_of_the_event():
    process = serve("lock = stop._cond; lock.acquire(); signal.raise_signal(15); lock.release(); stop.wait()")
    assert end(process)[0] == 0


def test_the_second_signal_forces_the_exit():
    process = serve("print('on', flush=True); stop.wait(); print('draining', flush=True); Event().wait()")
    assert process.stdout.readline() == "on\n"
    process.send_signal(signal.SIGINT)
    assert process.stdout.readline() == "draining\n"
    process.send_signal(signal.SIGINT)
    assert end(process)[0] == 128 + signal.SIGINT


def test_a_signal_after_a_stop_of_another_kind_is_the_first():
    process = serve("stop.set(); signal.raise_signal(15)")
    assert end(process)[0] == 0


def test_a_supervised_process_ends_with_its_supervisor():
    process = serve("print('on', flush=True); stop.wait()", **{SUPERVISED: "1"})
    assert process.stdout.readline() == "on\n"
    process.stdin.close()
    process.stdin = None
    assert end(process)[0] == 0


@pytest.mark.parametrize(
    ("error", "code", "says"),
    [
        ("stop.set() or NoRouterError('tcp/x', 1.0, stopped=True)", 0, "INFO    test: stopped after"),
        ("NoRouterError('tcp/x', 1.0)", 1, "ERROR   test: no router at tcp/x"),
        ("ConfigurationError('file', 'field', 'is wrong')", 2, "file: field: is wrong"),
        ("EndpointError('tcp/x', 'Address in use')", 1, "is another router running"),
        ("EndpointError('tcp/x', 'invalid socket address')", 1, "an address of this machine, with a port"),
        ("ValueError('unexpected')", 1, "Traceback"),
    ],
)
def test_what_the_body_raises_is_told_and_becomes_the_exit_code(error, code, says):
    ended, said = end(serve(f"raise {error}"))
    assert ended == code
    assert says in said
