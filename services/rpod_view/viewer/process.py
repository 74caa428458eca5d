"""Runs Rerun's program for a view, and ends when the view ends, for whatever reason.

It is started as ``python -m rpod_view.viewer.process`` in its own process group. Its standard input is a pipe
whose other end the view holds.
"""

import os
import signal
import sys
from threading import Thread

from rerun_cli.__main__ import main

from rpod_view.viewer.scheduling import lower_priority


def _end_with_view() -> None:
    while os.read(sys.stdin.fileno(), 4096):
        pass
    os.killpg(0, signal.SIGKILL)


if __name__ == "__main__":
    lower_priority()
    Thread(target=_end_with_view, daemon=True).start()
    sys.exit(main())
