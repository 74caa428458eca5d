"""The result of one check."""

from dataclasses import dataclass
from enum import StrEnum

CAMERA_FRAME_BYTES = 2 * 352 * 287 * 4
"""Depth and amplitude of the documented PMD camera, 352 x 287 pixels of 32FC1."""
CAMERA_HZ = 45.0
"""Its highest rate."""
CAMERA_MB_S = CAMERA_FRAME_BYTES * CAMERA_HZ / 1e6


class Level(StrEnum):
    """Result of a check."""

    OK = "ok"
    NOTE = "note"
    """Good enough for some facilities; the text says for which."""
    FAIL = "fail"
    UNCHECKED = "unchecked"


@dataclass(frozen=True)
class Finding:
    """One line of the doctor."""

    check: str
    """Subject of the check."""
    level: Level
    text: str
    """Result, with figures."""
    remedy: str = ""
    """Remedy; empty if none is needed."""
