"""Searches of a live estimator, in one worker for each sensor.

A search begins when the navigator requests it, and its result is available at the first frame of the sensor
after its end. Unsuccessful searches are limited (``backoff.py``); this module measures the time of each one.
"""

import time
from collections import defaultdict
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from threading import Event
from typing import Any, Protocol, Self

from rpod_estimator.backoff import Backoff
from rpod_pose.navigation.first_pose.searches import Found, Search
from rpod_pose.ports import Methods

READY_S = 60.0
"""Longest time for which the estimator's start waits for the workers; earlier searches wait for them."""


class Worker(Protocol):
    """Searches for one sensor, one search at a time, and never blocks the caller."""

    @property
    def is_ready(self) -> bool:
        """Whether a search would begin at once."""
        ...

    def begin(self, search: Search, setup: Any) -> None:
        """Start a search in a frame of a sensor with this setup."""
        ...

    def result(self) -> Found | None:
        """Return the result of the newest search; None while it runs."""
        ...

    def cancel(self) -> None:
        """Cancel the newest search."""
        ...

    def end(self) -> None:
        """End the worker at once."""
        ...


@dataclass
class _Running:
    search: Search
    began_s: float
    found: Found | None = None
    """Result of the search, which the navigator has not fetched yet."""
    is_reported: bool = False

    @property
    def stamp_ns(self) -> int:
        return self.search.event.stamp_ns


class LiveSearches:
    """Searches in workers, and limits unsuccessful searches.

    Args:
        workers: worker of each sensor, by its name.
        now_s: monotonic clock, s.
    """

    def __init__(
        self,
        workers: Mapping[str, Worker],
        *,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._workers, self._now_s = workers, now_s
        self._setups: Mapping[str, Any] = {}
        self._running: dict[str, _Running] = {}
        self._backoffs = defaultdict[str, Backoff](Backoff)

    def of(self, _methods: Mapping[str, Methods], setups: Mapping[str, Any]) -> Self:
        """Return this port for an estimator whose sensors have these setups.

        The methods are not used, since the workers have their own.
        """
        self._setups = setups
        return self

    def result(self, search: Search) -> Found | None:
        """Return the result of a search, or None while it runs; the first call starts the search."""
        running = self._running.get(search.sensor)
        if running is None or running.stamp_ns != search.event.stamp_ns:
            return self._begin(search)
        found = running.found or self._workers[search.sensor].result()
        if found is not None:
            del self._running[search.sensor]
            if not found.acquisition.begins_track and search.follow is None:
                data, now_s = search.event.data, self._now_s()
                self._backoffs[search.sensor].take(data, began_s=running.began_s, now_s=now_s)
        return found

    def _begin(self, search: Search) -> Found | None:
        worker, now_s = self._workers[search.sensor], self._now_s()
        if self._running.pop(search.sensor, None):
            worker.cancel()
        if search.follow is None and self._backoffs[search.sensor].is_paused(search.event.data, now_s):
            return Found.not_searched()
        worker.begin(search, self._setups[search.sensor])
        self._running[search.sensor] = _Running(search, now_s)
        return None

    def unreported(self, sensor: str) -> tuple[Search, Found] | None:
        """Return the ended search of a sensor whose result waits for the next frame; only once for each."""
        running = self._running.get(sensor)
        if running is None or running.is_reported:
            return None
        running.found = running.found or self._workers[sensor].result()
        running.is_reported = running.found is not None
        return None if running.found is None else (running.search, running.found)

    def keep(self, searches: Collection[Search]) -> None:
        """Cancel all searches except these."""
        wanted = {(search.sensor, search.event.stamp_ns) for search in searches}
        for sensor, worker in self._workers.items():
            running = self._running.get(sensor)
            if running is None or (sensor, running.stamp_ns) not in wanted:
                self._running.pop(sensor, None)
                worker.cancel()

    @property
    def pause_s(self) -> float:
        """Longest time between two searches, s; 0 while none is limited."""
        return max((backoff.pause_s for backoff in self._backoffs.values()), default=0.0)

    def end_pauses(self) -> None:
        """Search every frame again: something has changed."""
        for backoff in self._backoffs.values():
            backoff.end()

    def await_workers(self, stop: Event) -> None:
        """Wait until the workers are ready, or until stopped."""
        deadline_s = self._now_s() + READY_S
        while not all(worker.is_ready for worker in self._workers.values()):
            if self._now_s() > deadline_s or stop.wait(0.02):
                return
