"""Stamps of each sensor's newest frames, by which the navigator knows whether they support the track."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from math import inf

from rpod_schemas.messages import NANOSECONDS

RESTS = "not searched: the last search found nothing, and another sensor must not wait"
"""Reason for which a frame without a track is not used."""
PERIODS = 1.5
"""Number of a slow sensor's periods within which it must deliver its next measurement. Hand: half a period is
for jitter; two periods would wait for a measurement that is lost."""


@dataclass(frozen=True)
class Stream:
    """Stamps of one sensor's newest frames. None stands for no frame, because 0 is a valid stamp too."""

    heard_ns: int | None = None
    """Stamp of the newest frame; None if there is none."""
    period_ns: int | None = None
    """Time between the two newest frames; None if unknown."""
    searched_ns: int | None = None
    """Stamp of the newest frame that was searched without a guess; None if there is none."""
    accepted_ns: int | None = None
    """Newest stamp of a frame that the present track has accepted; None if there is none."""

    def since_s(self, stamp_ns: int) -> float:
        """Return the time between a stamp and the newest accepted frame, s; infinite if there is none."""
        return inf if self.accepted_ns is None else abs(stamp_ns - self.accepted_ns) / NANOSECONDS

    def is_silent(self, stamp_ns: int, unknown_s: float) -> bool:
        """Return whether no frame has arrived although one was due at a stamp.

        ``unknown_s`` is the time, s, after which one is due if the sensor's period is not known yet.
        """
        if self.heard_ns is None:
            return False
        return (stamp_ns - self.heard_ns) / NANOSECONDS > self._late_s(unknown_s)

    def supports(self, stamp_ns: int, at_least_s: float, unknown_s: float = 0.0) -> bool:
        """Return whether the newest accepted frame is new enough to support the track at a stamp.

        Args:
            stamp_ns: the stamp.
            at_least_s: age up to which a measurement of a fast sensor is new.
            unknown_s: the same for a sensor whose period is not known yet.
        """
        if self.accepted_ns is None:
            return False
        return (stamp_ns - self.accepted_ns) / NANOSECONDS <= max(at_least_s, self._late_s(unknown_s))

    def _late_s(self, unknown_s: float) -> float:
        return unknown_s if self.period_ns is None else PERIODS * self.period_ns / NANOSECONDS


Streams = Mapping[str, Stream]
"""The sensors' frames, by the name of the sensor."""


def heard(streams: Streams, sensor: str, stamp_ns: int) -> Streams:
    """Return the streams after a frame has arrived.

    One long gap is a pause, not a new rate: the period at most doubles from one frame to the next.
    """
    stream = streams.get(sensor, Stream())
    before_ns = stream.heard_ns
    if before_ns is not None and stamp_ns <= before_ns:
        return streams
    period_ns = None if before_ns is None else stamp_ns - before_ns
    if period_ns is not None and stream.period_ns is not None:
        period_ns = min(period_ns, 2 * stream.period_ns)
    return {**streams, sensor: replace(stream, heard_ns=stamp_ns, period_ns=period_ns)}


def supported(streams: Streams, sensor: str, stamp_ns: int) -> Streams:
    """Return the streams after the track has accepted a frame."""
    stream = streams.get(sensor, Stream())
    newest_ns = stamp_ns if stream.accepted_ns is None else max(stream.accepted_ns, stamp_ns)
    return {**streams, sensor: replace(stream, accepted_ns=newest_ns)}


def begun(streams: Streams, sensor: str = "", stamp_ns: int = 0) -> Streams:
    """Return the streams when a track begins: only the sensor of its first frame supports it, if any."""
    none = {name: replace(stream, accepted_ns=None) for name, stream in streams.items()}
    return supported(none, sensor, stamp_ns) if sensor else none


def searched(streams: Streams, sensor: str, stamp_ns: int) -> Streams:
    """Return the streams after a search without a guess in a frame."""
    return {**streams, sensor: replace(streams.get(sensor, Stream()), searched_ns=stamp_ns)}


def is_paused(streams: Streams, sensor: str, stamp_ns: int, pause_s: float) -> bool:
    """Return whether the last search was so recent that a frame is not searched.

    Otherwise unsuccessful searches would delay another sensor.
    """
    searched_ns = streams.get(sensor, Stream()).searched_ns
    return searched_ns is not None and 0.0 <= (stamp_ns - searched_ns) / NANOSECONDS < pause_s


def is_recent(streams: Streams, sensor: str, stamp_ns: int, now_ns: int, at_least_s: float) -> bool:
    """Return whether a sensor's next frame after the one at ``stamp_ns`` is not yet overdue at ``now_ns``."""
    return replace(streams.get(sensor, Stream()), accepted_ns=stamp_ns).supports(now_ns, at_least_s)


def supporters(streams: Streams) -> list[str]:
    """Return the sensors of which the present track has accepted a frame, the newest first."""
    accepted = {
        name: stream.accepted_ns for name, stream in streams.items() if stream.accepted_ns is not None
    }
    return sorted(accepted, key=lambda name: (-accepted[name], name))


def silent_since_s(streams: Streams, stamp_ns: int) -> float:
    """Return the time since the newest frame of any sensor, accepted or not, s; infinite if there is none."""
    return _since_s((stream.heard_ns for stream in streams.values()), stamp_ns)


def supported_ns(streams: Streams) -> int | None:
    """Return the stamp of the newest accepted measurement; None if there is none."""
    stamps_ns = [stream.accepted_ns for stream in streams.values() if stream.accepted_ns is not None]
    return max(stamps_ns, default=None)


def unsupported_s(streams: Streams, stamp_ns: int) -> float:
    """Return the time since the newest accepted measurement, s; infinite if there is none."""
    return _since_s((stream.accepted_ns for stream in streams.values()), stamp_ns)


def _since_s(stamps_ns: Iterable[int | None], stamp_ns: int) -> float:
    newest_ns = max((one_ns for one_ns in stamps_ns if one_ns is not None), default=None)
    return inf if newest_ns is None else (stamp_ns - newest_ns) / NANOSECONDS


def is_supported(streams: Streams, stamp_ns: int, *, at_least_s: float, unknown_s: float) -> bool:
    """Return whether the newest measurement of any sensor is new enough.

    Args:
        streams: the sensors' frames.
        stamp_ns: the time.
        at_least_s: age up to which a measurement of a fast sensor is new.
        unknown_s: the same for a sensor whose period is not known yet.
    """
    return any(stream.supports(stamp_ns, at_least_s, unknown_s) for stream in streams.values())
