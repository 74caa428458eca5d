"""Requests of operators to a driver: settings and triggers.

A query arrives in a thread of the bus, but a driver is used in one thread only, that of the host. So a
request waits until the host has the next item of the driver, and the driver needs no lock.

Settings are the query ``settings``, and parameters of the node, ``settings.<name>``, for the tools of ROS 2.
"""

import logging
import time
from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from functools import partial
from queue import Empty, SimpleQueue
from typing import Any

from rpod_driver.errors import NoAnswerError, NotSupportedError
from rpod_driver.ports import Adjustable, Triggered
from rpod_runtime import Node
from rpod_runtime.errors import RefusedError
from rpod_schemas.config.driver import DriverConfig, Setting
from rpod_schemas.control import Accepted, SettingsReply, SettingsRequest
from rpod_schemas.control import Empty as NoFields

log = logging.getLogger(__name__)

_ANSWER_S = 3.0
"""Longest wait of a request for the host: a driver yields an item at least once a second."""


class Commands:
    """Settings and triggers of one driver."""

    def __init__(self, node: Node, driver: Any, config: DriverConfig) -> None:
        self._driver, self._name = driver, config.name
        self._timeout_s = config.trigger_timeout_s
        self._configured: dict[str, Setting] = dict(config.settings)
        self._changed: dict[str, Setting] = {}
        """Settings that an operator has changed, in the order in which they were written last."""
        self._asked: SimpleQueue[tuple[Callable[[], Any], Future[Any]]] = SimpleQueue()
        self._triggers_s: deque[float] = deque()
        self.trigger_missed = 0
        """Number of requested triggers without a frame in time."""
        self._parameters = node.parameters
        node.serve("settings", SettingsRequest, self._settings)
        node.serve("trigger", NoFields, lambda _: self._run_in_driver(self._trigger))

    def restore(self) -> None:
        """Write the settings to a device that has just been connected: the configuration's, then the changes.

        Changes that the device does not take now are logged and dropped: a connection does not fail for them.

        Raises:
            NotSupportedError: settings are configured, but the driver has none.
        """
        self._triggers_s.clear()
        if self._configured:
            self._adjustable().apply(dict(self._configured))
        if self._changed:
            self._restore_changes(self._adjustable())
        if isinstance(self._driver, Adjustable):
            self._offer(dict(self._driver.settings()))

    def _restore_changes(self, device: Adjustable) -> None:
        try:
            device.apply(dict(self._changed))
        except Exception as error:  # noqa: BLE001 - drivers raise what their device's library raises
            device.settings()  # raises if the device itself has failed; then the changes are kept
            log.error(
                "%s: the settings that were changed while it ran (%s) cannot be written again: %s; the "
                "device has those of the configuration now: change them again",
                self._name,
                ", ".join(self._changed),
                str(error) or type(error).__name__,
            )
            self._changed.clear()

    def serve(self, *, got_frame: bool) -> None:
        """Answer the requests, and check the triggers; called by the host between two items."""
        if got_frame and self._triggers_s:
            self._triggers_s.popleft()
        while self._triggers_s and time.monotonic() - self._triggers_s[0] > self._timeout_s:
            self._triggers_s.popleft()
            self.trigger_missed += 1
        while True:
            try:
                act, answer = self._asked.get_nowait()
            except Empty:
                return
            if not answer.set_running_or_notify_cancel():
                continue
            try:
                answer.set_result(act())
            except Exception as error:  # noqa: BLE001 - the query gets any error as its reply
                answer.set_exception(error)

    def _run_in_driver(self, act: Callable[[], Any]) -> Any:
        answer: Future[Any] = Future()
        self._asked.put((act, answer))
        try:
            return answer.result(_ANSWER_S)
        except TimeoutError as error:
            answer.cancel()
            raise NoAnswerError(self._name, _ANSWER_S) from error

    def _adjustable(self) -> Adjustable:
        if not isinstance(self._driver, Adjustable):
            raise NotSupportedError(self._name, "settings", "settings and apply")
        return self._driver

    def _change(self, request: SettingsRequest) -> SettingsReply:
        device = self._adjustable()
        if request.settings:
            device.apply(request.settings)
            for name, value in request.settings.items():
                self._changed.pop(name, None)
                self._changed[name] = value
        return SettingsReply(settings=dict(device.settings()))

    def _settings(self, request: SettingsRequest) -> SettingsReply:
        reply: SettingsReply = self._run_in_driver(lambda: self._change(request))
        self._offer(reply.settings)  # in this thread: one that sets a parameter may hold its lock and wait
        return reply

    def _offer(self, settings: Mapping[str, Setting]) -> None:
        for name, value in settings.items():
            self._parameters.offer(
                f"settings.{name}",
                value,
                partial(self._set, name),
                description=f"setting {name!r} of the device",
                constraints="what the device takes",
            )

    def _set(self, name: str, value: Setting) -> None:
        """Write one setting for a client of the parameter services.

        Raises:
            RefusedError: the device does not take it, or does not answer; the text is the device's.
        """
        try:
            self._run_in_driver(lambda: self._change(SettingsRequest(settings={name: value})))
        except Exception as error:  # drivers raise what their device's library raises
            raise RefusedError(str(error) or type(error).__name__) from error

    def _trigger(self) -> Accepted:
        if not isinstance(self._driver, Triggered):
            raise NotSupportedError(self._name, "trigger", "trigger")
        self._driver.trigger()
        self._triggers_s.append(time.monotonic())
        return Accepted()
