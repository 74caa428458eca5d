"""Due times of frames: one rule for the emulator, for lockstep, and for the count of frames.

A frame's number is ``round((stamp - epoch) * rate)`` (ICD section 4).
"""

import heapq
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import count
from math import floor

from rpod_schemas.config.emulator import SensorConfig
from rpod_schemas.messages import NANOSECONDS


@dataclass(frozen=True, order=True)
class DueFrame:
    """One frame of one sensor; ordered by stamp, then by the sensor's name."""

    stamp_ns: int
    sensor: str
    number: int
    available_ns: int
    """Time at which the sensor hands the frame out, ns: stamp, half the exposure or scan, read-out."""


def frame_at(sensor: SensorConfig, number: int, *, epoch_ns: int) -> DueFrame:
    """Return a sensor's frame by its number."""
    stamp_ns = epoch_ns + round(number * NANOSECONDS / sensor.rate_hz)
    return DueFrame(stamp_ns, sensor.name, number, stamp_ns + round(sensor.latency_s * NANOSECONDS))


def last_number(sensor: SensorConfig, until_ns: int, *, epoch_ns: int) -> int:
    """Return the number of a sensor's last frame with a stamp up to a time; 0 is the epoch's."""
    number = floor((until_ns - epoch_ns) * sensor.rate_hz / NANOSECONDS) + 1  # rounded, one too many at most
    while frame_at(sensor, number, epoch_ns=epoch_ns).stamp_ns > until_ns:
        number -= 1
    return number


@dataclass(frozen=True)
class Step:
    """One step of lockstep: the time of the clock at which one frame is handed out."""

    time_ns: int
    frame: DueFrame


def lockstep_steps(
    sensors: Sequence[SensorConfig], *, epoch_ns: int, duration_s: float | None = None
) -> Iterator[Step]:
    """Yield the steps of lockstep in the order of time (ICD section 4).

    The time of a step is the one at which its sensor hands the frame out. Frames that several sensors hand
    out at the same time follow each other in the order of the sensors' names, a nanosecond apart. Therefore
    the clock alone determines which frame is next, and motion and emulator need no other agreement.

    Args:
        sensors: all sensors that are emulated.
        epoch_ns: time from which frames are numbered.
        duration_s: duration, s; stamps are in (epoch, epoch + duration]. None for no end.
    """
    until_ns = None if duration_s is None else epoch_ns + round(duration_s * NANOSECONDS)
    going_on = {sensor.name for sensor in sensors}
    time_ns = epoch_ns
    frames = heapq.merge(
        *(_frames(sensor, epoch_ns=epoch_ns) for sensor in sensors),
        key=lambda frame: (frame.available_ns, frame.sensor),
    )
    for frame in frames:
        time_ns = max(frame.available_ns, time_ns + 1)  # frames beyond the end keep their place in time
        if until_ns is None or frame.stamp_ns <= until_ns:
            yield Step(time_ns, frame)
            continue
        going_on.discard(frame.sensor)
        if not going_on:
            return


def _frames(sensor: SensorConfig, *, epoch_ns: int) -> Iterator[DueFrame]:
    return (frame_at(sensor, number, epoch_ns=epoch_ns) for number in count(1))
