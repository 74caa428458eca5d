"""One line of the check's result."""

from enum import StrEnum

from pydantic import Field

from rpod_schemas.config.base import Config
from rpod_schemas.faults import BY_NAME


class Level(StrEnum):
    """Result of one line."""

    OK = "ok"
    """Checked, and right."""
    NOTE = "note"
    """Checked, and right, with a remark in the text."""
    FAIL = "fail"
    """Wrong."""
    UNCHECKED = "not checked"
    """The frames do not show it; the text states why, and what would show it."""


class CheckResult(Config):
    """Result of one line of the check."""

    line: str
    """Name of the line."""
    level: Level
    """Result."""
    text: str
    """Figures in words; for ``not checked`` the reason."""
    figures: dict[str, float] = Field(default_factory=dict)
    """Figures by name, each with its unit."""
    faults: tuple[str, ...] = ()
    """Faults of the catalogue that explain it, the most probable first."""

    @property
    def remedy(self) -> str:
        """Remedy, from the catalogue; empty if nothing is wrong."""
        return "; or ".join(BY_NAME[name].remedy for name in self.faults)


def ok(line: str, text: str, **figures: float) -> CheckResult:
    """Return a result of a line that is in order."""
    return CheckResult(line=line, level=Level.OK, text=text, figures=figures)


def note(line: str, text: str, **figures: float) -> CheckResult:
    """Return a result of a line that is in order, with something to know."""
    return CheckResult(line=line, level=Level.NOTE, text=text, figures=figures)


def unchecked(line: str, reason: str, **figures: float) -> CheckResult:
    """Return a result of a line that could not be checked."""
    return CheckResult(line=line, level=Level.UNCHECKED, text=reason, figures=figures)


def fail(line: str, text: str, *faults: str, **figures: float) -> CheckResult:
    """Return a result of a line that is wrong."""
    return CheckResult(line=line, level=Level.FAIL, text=text, faults=faults, figures=figures)
