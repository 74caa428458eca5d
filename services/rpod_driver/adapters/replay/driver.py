"""The driver that plays recordings at their pace, as if their frames were taken now."""

import time
from collections.abc import Iterator
from typing import Any

from rpod_driver.adapters.replay.bag import Bag
from rpod_driver.adapters.replay.config import ReplayConfig
from rpod_driver.adapters.replay.images import ImageFolder
from rpod_driver.pauses import Pauses
from rpod_runtime.sensor_data.end_watch import last_of
from rpod_schemas.messages import NANOSECONDS
from rpod_schemas.types import SensorFrame, SensorInfo, SensorSync


def open_driver(config: ReplayConfig) -> "PlayedSensor":
    """Return the driver. Raises ``RecordingError``, ``MissingSdkError``."""
    device = config.device
    if device.images is not None:
        return PlayedSensor(config, ImageFolder(device.images))
    assert device.bag is not None  # noqa: S101 - the configuration has one of both
    return PlayedSensor(config, Bag(config, device.bag))


class PlayedSensor:
    """A sensor whose frames are in a recording. The speed divides the times between them."""

    def __init__(self, config: ReplayConfig, recording: Bag | ImageFolder) -> None:
        self._recording, self._device = recording, config.device
        self._pauses = Pauses()

    def connect(self) -> Any:
        """Return the recorded info, None if there is none."""
        self._pauses = Pauses()
        return self._recording.info()

    def frames(self) -> Iterator[SensorFrame | None]:
        """Yield the frames, stamped as if taken now; None while the next one is not due."""
        info = self._recording.info()  # once: the file is opened for it
        stated_s = info.duration_s if isinstance(info, SensorInfo) else 0.0
        begin_ns = time.time_ns()
        for _ in range(self._device.repeat):
            first_ns = last_ns = step_ns = None
            for frame in self._recording.frames():
                first_ns = frame.stamp_ns if first_ns is None else first_ns
                step_ns = frame.stamp_ns - last_ns if last_ns is not None else step_ns
                last_ns = frame.stamp_ns
                due_ns = begin_ns + round((frame.stamp_ns - first_ns) / self._device.speed)
                left_s = (due_ns - time.time_ns()) / NANOSECONDS + _after_s(frame, stated_s)
                yield from self._pauses.until(time.monotonic() + left_s)
                yield frame.model_copy(update={"stamp_ns": due_ns})
            if first_ns is not None and last_ns is not None:
                length_ns = last_ns - first_ns + (step_ns or NANOSECONDS)
                begin_ns += round(length_ns / self._device.speed)

    def close(self) -> None:
        """Do nothing: the file is closed after each pass."""

    def due_s(self) -> float:
        """Return when the next frame is due, s of the monotonic clock, also in a gap of the recording."""
        return self._pauses.due_s

    def sync(self) -> SensorSync:
        """Return that stamps are the recording's, moved to now."""
        return SensorSync(stamp_source="mapped")


def _after_s(frame: SensorFrame, stated_s: float) -> float:
    """Return the time from the stamp to the last measurement: no sensor sends a frame before it."""
    return max(0.0, last_of(frame, stated_s).after_s)
