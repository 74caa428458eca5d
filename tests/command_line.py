"""The command line called in this process: an interpreter of its own for each refusal takes a second."""

import logging
import sys
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from subprocess import CompletedProcess
from unittest.mock import patch

from rpod.__main__ import main


def called(*arguments: object) -> CompletedProcess[str]:
    """Call ``rpod`` with arguments; return exit code and output as of a process.

    The level and the handlers of the root logger are as before afterwards.
    """
    out, err, root = StringIO(), StringIO(), logging.getLogger()
    level, handlers = root.level, root.handlers[:]
    argv = ["rpod", *map(str, arguments)]
    with patch.object(sys, "argv", argv), redirect_stdout(out), redirect_stderr(err):
        try:
            main()
            code = 0
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else int(bool(end.code))
        finally:
            root.setLevel(level)
            root.handlers[:] = handlers
    return CompletedProcess(argv, code, out.getvalue(), err.getvalue())
