"""What holds for every test."""

import gc
from collections.abc import Generator

import pytest
from hypothesis import settings

settings.register_profile("rpod", deadline=None)  # a busy machine is not a fault
settings.load_profile("rpod")

MEASURED = "measured"
"""Name of the property by which a test states a figure, for the end of the run."""


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Collect the tests without the garbage collector, which then leaves out what lives as long as the run.

    Modules and tests are millions of objects. The collector would look through them again and again.
    """
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print the figures that tests stated, from all processes of the run."""
    for report in terminalreporter.getreports("passed"):
        for name, value in report.user_properties:
            if name == MEASURED:
                terminalreporter.line(f"{report.nodeid}: {value}")
