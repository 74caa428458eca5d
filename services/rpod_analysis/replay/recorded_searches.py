"""Searches of a replay, whose results are applied at the frames at which the live run applied them.

The evidence in the status of each frame tells whether a search began in it, and whether the result of an
earlier one was applied (ICD section 3).
"""

from collections.abc import Collection, Mapping
from typing import Any, Self

from rpod_estimator.search_process import found_as_in_process
from rpod_pose.navigation.first_pose.searches import AGE_S, BEGUN, Found, Search, find
from rpod_pose.ports import Methods


class RecordedSearches:
    """Searches inline, when the log says so."""

    def __init__(self) -> None:
        self.evidence: Mapping[str, float] = {}
        """Evidence in the status that the live run gave to the present frame."""
        self._methods: Mapping[str, Methods] = {}

    def of(self, methods: Mapping[str, Methods], _setups: Mapping[str, Any]) -> Self:
        """Return this port for an estimator with these methods."""
        self._methods = methods
        return self

    def result(self, search: Search) -> Found | None:
        """Return the result of a search at the frame at which the live run had it; None before."""
        if not search.waited and BEGUN in self.evidence:
            return None
        if not search.waited and AGE_S in self.evidence:  # a pause after a search that failed
            return Found.not_searched()
        if search.waited and AGE_S not in self.evidence:
            return None
        methods = self._methods[search.sensor]
        return found_as_in_process(search, methods) if search.waited else find(search, methods)

    def keep(self, searches: Collection[Search]) -> None:
        """Do nothing: no search runs between two frames."""
