"""The host of a driver: connects, publishes, reports the sensor's health, and reconnects after errors."""

import logging
import time
from collections import deque
from collections.abc import Iterator
from importlib.metadata import version as installed
from pathlib import Path
from threading import Event
from typing import Any

from pydantic import ValidationError

from rpod_driver.commands import Commands
from rpod_driver.errors import DriverError, SilentSensorError, StoppedError, WrongKindError
from rpod_driver.ports import Counted, Driver, Paced, Stoppable, Synchronised
from rpod_runtime import Node
from rpod_runtime.process import lifecycle
from rpod_runtime.process.notify import manager
from rpod_runtime.sensors import SensorPublisher, open_publisher
from rpod_schemas.config.base import load
from rpod_schemas.config.driver import DriverConfig
from rpod_schemas.errors import MessageRejectedError
from rpod_schemas.registry import resolve
from rpod_schemas.sensors import sensor_kind
from rpod_schemas.types import Health, SensorFrame, SensorSync

log = logging.getLogger(__name__)

_RATE_FRAMES = 32
"""Number of frames over which the rate is computed."""


def main(driver: Driver, config: DriverConfig | Path | str) -> int:
    """Run a driver as a process, with signals and log lines, until its source ends or it is stopped.

    Args:
        driver: driver of the sensor.
        config: configuration, as a model or as the path of its file.

    Returns:
        The exit code: 0 at a normal end, 1 on failure, 2 for a configuration that cannot be used.
    """

    def body(stop: Event) -> None:
        checked = config if isinstance(config, DriverConfig) else load(DriverConfig, Path(config))
        run(driver, checked, version=installed("rpod"), stop=stop)

    return lifecycle.run(config.instance if isinstance(config, DriverConfig) else "driver", body)


def run(driver: Driver, config: DriverConfig, *, version: str, stop: Event) -> None:
    """Publish the frames of a driver until its source ends or it is stopped."""
    with Node(config, version=version, stop=stop) as node:
        host = Host(node, driver, config)
        node.health.watch(host.check)
        while not (host.finished or stop.is_set()):
            manager.alive()
            host.serve_connection()
        node.state = "finished"


class Host:
    """The publishing and the health of a driver's sensor, over all its connections."""

    def __init__(self, node: Node, driver: Driver, config: DriverConfig) -> None:
        self._node, self._driver, self._config = node, driver, config
        self._publisher = open_publisher(node, config.kind, config.name, config.T_chaser_sensor)
        self._reduced: SensorPublisher | None = None
        if config.reduced_rate is not None:
            self._reduced = resolve(sensor_kind(config.kind).reduced_rate)(
                node, config.name, config.reduced_rate
            )
        self._commands = Commands(node, driver, config)
        self._arrivals_s: deque[float] = deque(maxlen=_RATE_FRAMES)
        self._heard_s = time.monotonic()
        self._trouble = ""
        self._retry_s = config.retry_s
        self.finished = False
        if isinstance(driver, Stoppable):
            driver.take_stop(node.stop)

    def serve_connection(self) -> None:
        """Connect and publish until the source ends, the sensor fails, or a stop; wait after a failure."""
        try:
            info = self._driver.connect()
            try:
                self._begin(info)
                self._publish_all(self._driver.frames())
            finally:
                self._driver.close()
        except StoppedError as error:
            log.info("%s", error)
        except Exception as error:  # noqa: BLE001 - drivers raise what their device's library raises
            self._recover(error)

    def _begin(self, info: Any) -> None:
        self._heard_s = time.monotonic()
        self._arrivals_s.clear()
        self._commands.restore()
        if info is not None:
            self._publisher.announce(self._checked(info, self._publisher.info_type))
        self._node.ready(f"publishing {self._config.name}")

    def _publish_all(self, frames: Iterator[SensorFrame | None]) -> None:
        for frame in frames:
            manager.alive()
            if self._node.stop.is_set():
                return
            self._commands.serve(got_frame=frame is not None)
            if frame is not None:
                self._publish(frame)
            elif (silence_s := self._silence_s()) > self._config.silence_s:
                raise SilentSensorError(silence_s)
        self.finished = True
        log.info("the source has ended")

    def _silence_s(self) -> float:
        """Return the time without a frame, s, without a pause that the driver has announced."""
        due_s = self._driver.due_s() if isinstance(self._driver, Paced) else self._heard_s
        return time.monotonic() - max(self._heard_s, due_s)

    def _publish(self, frame: SensorFrame) -> None:
        self._heard_s = time.monotonic()
        self._arrivals_s.append(self._heard_s)
        try:
            frame = self._checked(frame, self._publisher.frame_type)
            self._publisher.publish(frame)
            if self._reduced is not None:
                self._reduced.publish(frame)
        except MessageRejectedError as error:
            self._node.reject(self._config.name, error)
        else:
            self._node.health.count(f"frames/{self._config.name}")
            if self._trouble:
                self._resume()

    def _checked(self, given: Any, expected: type[Any] | None) -> Any:
        """Return a frame or an info whose fields are checked: ``model_copy`` takes any value for them."""
        if expected is None or not isinstance(given, expected):
            raise WrongKindError(self._config.kind, given)
        try:
            return type(given).model_validate(dict(given))
        except ValidationError as error:
            raise DriverError(error_line(error)) from error

    def _resume(self) -> None:
        log.info("the sensor delivers frames again")
        self._trouble, self._retry_s = "", self._config.retry_s
        self._node.health.report(Health.OK, "the sensor delivers frames again")

    def _recover(self, error: Exception) -> None:
        before, self._trouble = self._trouble, error_line(error)
        self._node.health.count(f"failures/{self._config.name}")
        self._node.health.report(Health.ERROR, self._trouble)
        # For an unexpected error, the place in the code is logged once.
        expected = isinstance(error, OSError | DriverError) or self._trouble == before
        log.error("%s; connecting again in %g s", self._trouble, self._retry_s, exc_info=not expected)
        manager.attend(self._node.stop, self._retry_s)
        self._retry_s = min(2.0 * self._retry_s, self._config.max_retry_s)

    def check(self) -> tuple[Health, str]:
        """Return the sensor's health, which also reports a driver that hangs in its device."""
        age_s = time.monotonic() - self._heard_s
        self._node.health.measure("last_frame_age_s", age_s)
        self._node.health.measure("rate_hz", self._rate_hz())
        self._report_state()
        if self._trouble:
            return Health.ERROR, self._trouble
        if self.finished:
            return Health.OK, "the source has ended"
        if self._silence_s() > self._config.silence_s:
            return Health.ERROR, f"no frame for {age_s:.1f} s"
        if not self._arrivals_s:
            return Health.WARN, "no frame yet"
        return Health.OK, f"{self._rate_hz():.1f} Hz, last frame {age_s:.2f} s ago"

    def _report_state(self) -> None:
        """Report what the driver knows of its sensor's time and of lost frames."""
        name, missed = self._config.name, self._commands.trigger_missed
        sync = self._driver.sync() if isinstance(self._driver, Synchronised) else SensorSync()
        if missed:
            sync = sync.model_copy(update={"trigger_missed": missed + (sync.trigger_missed or 0)})
        for key, value in sync.values(name).items():
            self._node.health.set_text(key, value)
        if isinstance(self._driver, Counted):
            for stage, frames in self._driver.drops()._asdict().items():
                self._node.health.put(f"lost/{name}/{stage}", frames)

    def _rate_hz(self) -> float:
        arrivals_s = list(self._arrivals_s)
        if len(arrivals_s) < 2 or arrivals_s[-1] <= arrivals_s[0]:
            return 0.0
        return (len(arrivals_s) - 1) / (arrivals_s[-1] - arrivals_s[0])


def error_line(error: Exception) -> str:
    """Return an error in one line; of a frame or an info with wrong values, the fields."""
    if isinstance(error, ValidationError):
        wrong = [
            f"{'.'.join(map(str, each['loc']))}: {each['msg'].removeprefix('Value error, ')}"
            for each in error.errors(include_url=False, include_input=False)
        ]
        return f"{error.title}: {'; '.join(wrong)}"
    return str(error) or type(error).__name__
