"""A service that compiles at its first start is waited for; one that hangs is not."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from rpod.play import start_watch
from rpod.play.start_watch import StartWatch
from rpod_runtime.process.processes import processor_s

BUSY = "import sys\nprint(flush=True)\nwhile True: pass"
STILL = "import sys\nprint(flush=True)\nsys.stdin.read()"


@contextmanager
def running(code: str) -> Iterator[int]:
    with subprocess.Popen([sys.executable, "-c", code], stdin=-1, stdout=-1) as process:
        assert process.stdout is not None
        process.stdout.readline()
        try:
            yield process.pid
        finally:
            process.kill()


@pytest.mark.parametrize(("share", "is_idle"), [(0.1, False), (0.0, True)])
def test_a_service_is_idle_while_it_does_not_use_the_processor(monkeypatch, share, is_idle):
    now_s = 0.0
    monkeypatch.setattr(start_watch, "processor_s", lambda _: share * now_s)
    watch, longest_s = StartWatch(), 0.0
    for now_s in range(600):
        longest_s = max(longest_s, watch.idle_s(1, now_s))
    assert longest_s == (599.0 if is_idle else 9.0)


def test_the_time_of_a_process_grows_while_it_works():
    with running(BUSY) as busy, running(STILL) as still:
        rests_s = processor_s(still)
        first_s = processor_s(busy)
        for _ in range(10_000):
            if processor_s(busy) - first_s >= 0.2:
                break
            subprocess.run([sys.executable, "-c", "import time; time.sleep(0.05)"], check=True)
        assert processor_s(busy) - first_s >= 0.2
        assert processor_s(still) - rests_s < 0.1


def test_a_process_that_has_ended_has_used_no_time():
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    assert processor_s(process.pid) == 0.0
