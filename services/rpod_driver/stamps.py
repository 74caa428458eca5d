"""Stamps of devices as UTC.

A device that no server disciplines counts from its power-up, and its stamps must never be taken for UTC. They
are kept as intervals: the difference between arrival and stamp is at least the transport's delay and mostly
little more, so that its least value of the last seconds maps stamps to this machine's clock with much less
jitter than arrivals have (D. L. Mills, RFC 5905, clock filter: the sample with the least delay is the best).
What remains is the least delay itself, which only a clock in common can tell.
"""

import logging
import time
from collections import deque
from collections.abc import Callable
from typing import Literal, Self

from pydantic import Field, model_validator

from rpod_schemas.config.base import Config
from rpod_schemas.messages import NANOSECONDS
from rpod_schemas.types import SensorSync

log = logging.getLogger(__name__)

_UTC_WITHIN_NS = 86_400 * NANOSECONDS
"""Greatest offset of a clock of UTC or TAI from this machine's; a count from power-up is decades away."""
_WINDOW_NS = 10 * NANOSECONDS
"""Time over which the least delay is sought: crystals of 100 ppm drift by 1 ms in it."""

StampSource = Literal["device", "mapped", "host"]
_MEANING: dict[StampSource, str] = {
    "device": "the device's, which do not depend on arrivals",
    "mapped": "mapped to arrivals",
    "host": "those of the arrival",
}


class StampConfig(Config):
    """Conversion of a device's stamps to UTC."""

    source: Literal["auto", "device", "mapped", "host"] = "auto"
    """``device``: they are UTC; ``mapped``: they count from any time, and are mapped to arrival by the least
    delay of the last 10 s; ``host``: only the time of arrival counts, by this machine's clock. ``auto`` takes
    stamps within a day of this machine's clock as UTC, maps others, and takes ``host`` where there are
    none."""
    delay_s: float = Field(default=0.0, ge=0, le=10)
    """Least time from the middle of the exposure to the arrival of its frame, s, subtracted where stamps are
    mapped or of the arrival; of a scan with times of its points, from its last point. It cannot be measured
    from the frames alone. Where the device's stamps are taken as UTC it has no effect."""
    ahead_s: float = Field(default=0.0, ge=-86_400, le=86_400)
    """Length by which the device's stamps are ahead of the middle of the exposure in UTC, s, subtracted from
    them: 37 for a clock of TAI, less half the exposure if they are of its start, plus half of it if they are
    of its end. Where stamps are mapped or of the arrival it has no effect."""

    @model_validator(mode="after")
    def _each_correction_has_an_effect(self) -> Self:
        if self.source == "device" and self.delay_s:
            raise ValueError(
                "delay_s has no effect with source device, whose stamps do not depend on arrivals; give the "
                "offset of the device's stamps as ahead_s"
            )
        if self.source in ("mapped", "host") and self.ahead_s:
            raise ValueError(
                f"ahead_s has no effect with source {self.source}, whose stamps follow from arrivals; give "
                "the time from the middle of the exposure to the arrival as delay_s"
            )
        return self


class StampMapper:
    """Converts the stamps of one connection's frames to UTC, and logs once how."""

    def __init__(self, sensor: str, config: StampConfig, now_ns: Callable[[], int] = time.time_ns) -> None:
        self._sensor, self._config, self._now_ns = sensor, config, now_ns
        self._delay_ns, self._ahead_ns = (
            round(each * NANOSECONDS) for each in (config.delay_s, config.ahead_s)
        )
        self._offsets: deque[tuple[int, int]] = deque()
        self._last_device_ns = self._last_ns = -1
        self.source: StampSource | None = None

    @property
    def sync(self) -> SensorSync:
        """Facts about the device's clock."""
        return SensorSync(stamp_source=self.source)

    def utc_ns(self, device_ns: int | None, *, after_ns: int = 0) -> int:
        """Return the stamp of a frame that has just arrived, ns of UTC.

        Mapped stamps and stamps of arrival rise. Those of the device are passed on less ``ahead_s``.

        Args:
            device_ns: its stamp by the device's clock, ns; None if the device gives none.
            after_ns: time from the stamp to the last measurement of the frame, ns: a scan cannot arrive
                before its last point, so that this part of the delay is known.
        """
        now_ns = self._now_ns()
        if device_ns is not None:
            device_ns -= self._ahead_ns
        source = self._source(device_ns, now_ns)
        if source != self.source:
            self._log_source(source, device_ns)
        self.source = source
        if source == "device" and device_ns is not None:
            return device_ns
        ended_ns = (
            now_ns if source == "host" or device_ns is None else self._mapped_ns(device_ns + after_ns, now_ns)
        )
        self._last_ns = max(ended_ns - after_ns - self._delay_ns, self._last_ns + 1)
        return self._last_ns

    def _source(self, device_ns: int | None, now_ns: int) -> StampSource:
        if device_ns is None:
            return "host"
        if self._config.source != "auto":
            return self._config.source
        return "device" if abs(device_ns - now_ns) <= _UTC_WITHIN_NS else "mapped"

    def _mapped_ns(self, device_ns: int, now_ns: int) -> int:
        if device_ns < self._last_device_ns:
            log.warning("%s: its stamps went back: its clock has started again", self._sensor)
            self._offsets.clear()
        self._last_device_ns = device_ns
        offset_ns = now_ns - device_ns
        while self._offsets and self._offsets[-1][1] >= offset_ns:
            self._offsets.pop()
        self._offsets.append((now_ns, offset_ns))
        while self._offsets[0][0] < now_ns - _WINDOW_NS:
            self._offsets.popleft()
        return device_ns + self._offsets[0][1]

    def _log_source(self, source: StampSource, device_ns: int | None) -> None:
        name, without = ("delay_s", "ahead_s") if source == "device" else ("ahead_s", "delay_s")
        if given_s := getattr(self._config, name):
            text = "%s: %s (%g s) has no effect, since stamps are %s; give their offset as %s"
            log.warning(text, self._sensor, name, given_s, _MEANING[source], without)
        if source == "device":
            log.info("%s: stamps are the device's less ahead_s (%g s)", self._sensor, self._config.ahead_s)
        elif source == "mapped":
            log.warning(
                "%s: stamps of the device are not UTC (the newest is %.3f s, which counts from its power-up "
                "if nothing set its clock); they are mapped to arrival, and late by the least delay less "
                "delay_s (%g s): give the device an NTP or PTP server",
                self._sensor,
                (device_ns or 0) / NANOSECONDS,
                self._config.delay_s,
            )
        else:
            log.warning(
                "%s: the %s; frames are stamped at their arrival less delay_s (%g s), with its jitter",
                self._sensor,
                "device gives no stamps"
                if device_ns is None
                else "configuration takes no stamps of the device",
                self._config.delay_s,
            )
