"""The errors of the view. Each message is one line that contains the remedy."""

from pathlib import Path

from rpod_runtime.errors import BusError


class ViewError(BusError):
    """Root of the errors that this package raises."""


class ViewerFailedError(ViewError):
    """The viewer does not start; ``how`` completes the sentence "the viewer ..."."""

    def __init__(self, how: str) -> None:
        super().__init__(f"the viewer {how}; try --web, or --save FILE.rrd")


class GateError(ViewError):
    """The token of a viewer that other machines can reach cannot be used."""

    def __init__(self, file: Path, reason: str, remedy: str) -> None:
        super().__init__(f"the token in {file} {reason}; {remedy}")
