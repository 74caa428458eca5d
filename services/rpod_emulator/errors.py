"""Errors that this package raises."""

from rpod_schemas.errors import RpodError


class EmulatorError(RpodError):
    """Root of the errors that this package raises."""


class TruthGapError(EmulatorError):
    """The truth does not cover the exposure of a frame."""

    def __init__(self, stamp_ns: int, gap_s: float) -> None:
        super().__init__(f"no truth within {gap_s * 1e3:.1f} ms around the stamp {stamp_ns} ns")
