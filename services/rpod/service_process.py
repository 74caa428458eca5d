"""A service as a process: its files, its start, and the pipe whose end it takes as the end of its parent."""

import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from pydantic import BaseModel

from rpod_runtime.process.lifecycle import SUPERVISED
from rpod_schemas.caches.whole_file import whole_file

_TAIL_BYTES = 1 << 14
_LOG_BYTES = 16 << 20
"""Size of a file of log lines at which it is moved aside; the one before is kept."""


class ServiceFiles:
    """The configuration and the log lines of a service, in a folder that several services share."""

    def __init__(self, directory: Path, name: str) -> None:
        self.config = directory / "config" / f"{name}.json"
        self.log = directory / "logs" / f"{name}.log"

    def write_config(self, config: BaseModel) -> None:
        """Write the configuration for the next start. Raises ``OSError``."""
        text = config.model_dump_json(indent=2).encode()
        if self.config.is_file() and self.config.read_bytes() == text:
            return  # a restart needs no space on the disk
        self.config.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(self.config) as stream:
            stream.write(text)

    def start(self, arguments: Sequence[str], environment: dict[str, str]) -> subprocess.Popen[bytes]:
        """Start ``rpod`` in a session of its own, so that only its parent receives Ctrl-C.

        Args:
            arguments: verb and options.
            environment: variables beside those of this process.

        Raises:
            OSError: the process or its file of log lines cannot be created.
        """
        self.log.parent.mkdir(parents=True, exist_ok=True)
        with self.log.open("ab") as stream:
            return subprocess.Popen(
                [sys.executable, "-m", "rpod", *arguments],
                stdin=subprocess.PIPE,
                stdout=stream,
                stderr=stream,
                start_new_session=True,
                env=os.environ | {SUPERVISED: "1"} | environment,
            )

    def shorten_log(self) -> None:
        """Copy long log lines to ``<name>.log.1`` and empty their file, in which the process goes on.

        Lines that are written between both steps are lost. On a full disk the copy is left out.
        """
        if not self.log.exists() or self.log.stat().st_size <= _LOG_BYTES:
            return
        with suppress(OSError):
            shutil.copyfile(self.log, self.log.with_suffix(".log.1"))
        os.truncate(self.log, 0)

    def last_lines(self, count: int) -> list[str]:
        """Return the newest log lines, at most ``count``; none before the first start."""
        if not self.log.exists():
            return []
        return self.log.read_bytes()[-_TAIL_BYTES:].decode(errors="replace").splitlines()[-count:]


def close_pipe(process: subprocess.Popen[bytes]) -> None:
    """Close the pipe to a process that has ended."""
    if process.stdin:
        with suppress(OSError):  # what such a process has not read cannot be flushed
            process.stdin.close()
