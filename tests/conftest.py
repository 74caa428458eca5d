"""What holds for every test."""

import gc
from collections.abc import Generator
from pathlib import Path

import pytest
from hypothesis import settings

settings.register_profile("rpod", deadline=None)  # a busy machine is not a fault
settings.load_profile("rpod")

MEASURED = "measured"
"""Name of the property by which a test states a figure, for the end of the run."""

LIVE = {"e2e", "integration"}
"""Folders of the tests that start processes and wait for them."""
_LAST_LIVE = 0.8
"""Share of the run by which the last file of these begins, so that no worker is left alone with one."""


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Spread the files that wait over the run: who waits leaves its processor to those that compute."""
    files: dict[Path, list[pytest.Item]] = {}
    for item in items:
        files.setdefault(item.path, []).append(item)
    live = [path for path in files if LIVE & set(path.parts)]
    others = [path for path in files if not LIVE & set(path.parts)]
    places = {path: _LAST_LIVE * number / len(live) for number, path in enumerate(live)}
    places |= {path: number / len(others) for number, path in enumerate(others)}
    items[:] = [item for path in sorted(files, key=places.__getitem__) for item in files[path]]


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
