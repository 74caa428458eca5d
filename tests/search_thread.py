"""A worker of searches in a thread, in the place of the process that the estimator starts."""

import pickle
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cache
from typing import Any

from rpod_estimator.search_process import packed
from rpod_pose.methods import methods_of
from rpod_pose.navigation.first_pose.searches import Found, Search, find
from rpod_pose.ports import Methods
from rpod_schemas.config.sensor import SensorInput
from rpod_target import load_target


class SearchThread:
    """Searches for one sensor in a thread, with methods of its own."""

    is_ready = True

    def __init__(self, target: str, sensor: SensorInput, _loaded: object = None) -> None:
        self._target, self._sensor = target, sensor
        self._executor = ThreadPoolExecutor(1)
        self._future: Future[Found] | None = None

    def begin(self, search: Search, setup: Any) -> None:
        sent = packed((search.sent, setup))
        self._future = self._executor.submit(self._find, sent)

    def result(self) -> Found | None:
        return self._future.result() if self._future is not None and self._future.done() else None

    def cancel(self) -> None:
        self._future = None

    def end(self) -> None:
        self._executor.shutdown(cancel_futures=True)

    def _find(self, sent: bytes) -> Found:
        search, setup = pickle.loads(sent)  # noqa: S301 - our own
        kind, told = type(self._sensor), self._sensor.model_dump_json()
        return find(search, _methods(self._target, told, kind, pickle.dumps(setup)))


@cache
def _methods(target: str, sensor: str, kind: type[SensorInput], setup: bytes) -> Methods:
    known = pickle.loads(setup)  # noqa: S301 - our own
    return methods_of(kind.model_validate_json(sensor), load_target(target), known)
