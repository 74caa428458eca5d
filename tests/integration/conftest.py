from collections.abc import Iterator
from contextlib import ExitStack

import pytest
from live_bus import Bus, router
from search_thread import SearchThread

import rpod_estimator.daemon


@pytest.fixture(scope="session")
def endpoint() -> Iterator[str]:
    with router() as endpoint:
        yield endpoint


@pytest.fixture
def bus(endpoint: str) -> Iterator[Bus]:
    with ExitStack() as stack:
        yield Bus(endpoint, stack)


@pytest.fixture(autouse=True)
def searches_in_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let estimators search in threads of the test: each process would take seconds to start."""
    monkeypatch.setattr(rpod_estimator.daemon, "SearchProcess", SearchThread)
