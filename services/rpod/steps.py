"""Steps of a verb that takes long, on standard error: one line that is redrawn, or lines off a terminal."""

from types import TracebackType
from typing import Self

from rich.console import Console
from rich.status import Status


class Steps:
    """Says what a verb does now; nothing if it is quiet."""

    def __init__(self, *, quiet: bool) -> None:
        self._console = Console(markup=False, stderr=True, quiet=quiet, highlight=False)
        self._status: Status | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._status is not None:
            self._status.stop()

    def say(self, text: str) -> None:
        """Say which step begins."""
        if not self._console.is_terminal:
            self._console.print(f"{text} ...", soft_wrap=True)
        elif self._status is None:
            self._status = self._console.status(f"{text} ...")
            self._status.start()
        else:
            self._status.update(f"{text} ...")
