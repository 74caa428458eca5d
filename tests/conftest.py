"""What holds for every test."""

import pytest
from hypothesis import settings

settings.register_profile("rpod", deadline=None)  # a busy machine is not a fault
settings.load_profile("rpod")

MEASURED = "measured"
"""Name of the property by which a test states a figure, for the end of the run."""


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print the figures that tests stated, from all processes of the run."""
    for report in terminalreporter.getreports("passed"):
        for name, value in report.user_properties:
            if name == MEASURED:
                terminalreporter.line(f"{report.nodeid}: {value}")
