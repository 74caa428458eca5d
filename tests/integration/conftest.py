from collections.abc import Iterator
from contextlib import ExitStack

import pytest
from live_bus import Bus, router


@pytest.fixture(scope="session")
def endpoint() -> Iterator[str]:
    with router() as endpoint:
        yield endpoint


@pytest.fixture
def bus(endpoint: str) -> Iterator[Bus]:
    with ExitStack() as stack:
        yield Bus(endpoint, stack)
