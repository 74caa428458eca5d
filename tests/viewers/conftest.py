"""Logs of the facility for the readers, and a plain word at the end on what was checked with what."""

from pathlib import Path

import pytest
from facility_logs import (
    RUN_TIMEOUT_S,
    cut_and_recover,
    play_a_run,
    play_every_sensor,
    record_what_is_no_ros_message,
)
from machine import TOOLS, tool
from readers import HERE, Read, read_ours

from rpod_schemas.summary import Summary

RAN = pytest.StashKey[set[str]]()


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", "needs(*tools): leave the test out where one of TOOLS is not there")
    config.stash[RAN] = set()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in (item for item in items if HERE in item.path.parents):
        item.add_marker(pytest.mark.timeout(RUN_TIMEOUT_S))
        missing = [tool(name).missing for name in needed(item) if tool(name).missing]
        if missing:
            item.add_marker(pytest.mark.skip(reason="; ".join(dict.fromkeys(missing))))


def needed(item: pytest.Item) -> list[str]:
    return [name for marker in item.iter_markers("needs") for name in marker.args]


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Remember what is not left out."""
    item.config.stash[RAN].update(needed(item))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say what was checked and what was not, so that a green result is not taken for more than it is."""
    terminalreporter.section("readers and viewers")
    for name in TOOLS:
        found = tool(name)
        said = "checked" if name in terminalreporter.config.stash[RAN] else "not asked for"
        if found.missing:
            said = f"left out, since {found.missing}"
        terminalreporter.write_line(f"{found.name}: {said}")


@pytest.fixture(scope="session")
def summary(tmp_path_factory: pytest.TempPathFactory) -> Summary:
    """What a run of the standard scenario says of itself; log and report are beside it."""
    return play_a_run(tmp_path_factory.mktemp("run"))


@pytest.fixture(scope="session")
def every_sensor(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log of camera with raw samples, and LIDAR."""
    return play_every_sensor(tmp_path_factory.mktemp("every-sensor"))


@pytest.fixture(scope="session")
def recovered(every_sensor: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log that was cut, and recovered."""
    return cut_and_recover(every_sensor, tmp_path_factory.mktemp("recovered"))


@pytest.fixture(scope="session", params=["lz4", "zstd", "none"])
def opaque(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log, in each compression, in which there are bytes that are no ROS message."""
    return record_what_is_no_ros_message(tmp_path_factory.mktemp("opaque"), request.param)


@pytest.fixture(scope="session", params=["run", "every_sensor", "recovered"])
def log(request: pytest.FixtureRequest) -> Path:
    """Each of the facility's logs."""
    if request.param == "run":
        return Path(request.getfixturevalue("summary").log)
    return request.getfixturevalue(request.param)


@pytest.fixture(scope="session")
def ours(log: Path) -> list[Read]:
    """The log's messages as this project reads them, in the order of arrival."""
    return list(read_ours(log))
