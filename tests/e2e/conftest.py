from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from facility_process import FacilityProcess

Start = Callable[..., FacilityProcess]


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Start]:
    """Start runs that do not outlive the test."""
    with ExitStack() as stack:

        def start(*arguments: str) -> FacilityProcess:
            facility = FacilityProcess(*arguments, out=tmp_path / "runs")
            stack.callback(facility.close)
            return facility

        yield start
