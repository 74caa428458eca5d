"""Rerun's program for a view: it ends with the view, however that ends.

Run as ``python -m rpod_view.guarded`` in a process group of its own, with a pipe as standard input
whose other end the view holds.
"""

import os
import signal
import sys
from threading import Thread

from rerun_cli.__main__ import main

from rpod_view.priority import give_way


def _end_with_view() -> None:
    while os.read(sys.stdin.fileno(), 4096):
        pass
    os.killpg(0, signal.SIGKILL)


if __name__ == "__main__":
    give_way()
    Thread(target=_end_with_view, daemon=True).start()
    sys.exit(main())
