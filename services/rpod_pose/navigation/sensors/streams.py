"""The navigator's memory of each sensor's frames: whether they support the track."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

from rpod_schemas.messages import NANOSECONDS

RESTS = "not searched: the last search was in vain, and another sensor must not wait"
"""Reason for which a frame without a track is not used."""
PERIODS = 1.5
"""Number of its own periods in which a slow sensor must deliver its next measurement."""


@dataclass(frozen=True)
class Stream:
    """The frames of one sensor, accepted or not."""

    heard_ns: int = 0
    """Stamp of the newest frame."""
    period_ns: int = 0
    """Time between the two newest frames; 0 if unknown."""
    searched_ns: int = 0
    """Stamp of the newest frame that was searched without a guess, in vain; 0 if none."""
    accepted_ns: int = 0
    """Newest stamp of a frame that the present track has accepted; 0 if none."""

    def supports(self, stamp_ns: int, at_least_s: float, unknown_s: float = 0.0) -> bool:
        """Return whether the newest accepted frame is new enough to support the track at a stamp.

        Args:
            stamp_ns: the stamp.
            at_least_s: age up to which a measurement of a fast sensor is new.
            unknown_s: the same for a sensor whose period is not known yet.
        """
        if not self.accepted_ns:
            return False
        period_s = self.period_ns / NANOSECONDS
        allowed_s = max(at_least_s, PERIODS * period_s if period_s else unknown_s)
        return (stamp_ns - self.accepted_ns) / NANOSECONDS <= allowed_s


Streams = Mapping[str, Stream]
"""The sensors' frames, by the name of the sensor."""


def heard(streams: Streams, sensor: str, stamp_ns: int) -> Streams:
    """Return the streams after a frame has arrived."""
    stream = streams.get(sensor, Stream())
    if stamp_ns <= stream.heard_ns:
        return streams
    period_ns = stamp_ns - stream.heard_ns if stream.heard_ns else 0
    return {**streams, sensor: replace(stream, heard_ns=stamp_ns, period_ns=period_ns)}


def supported(streams: Streams, sensor: str, stamp_ns: int) -> Streams:
    """Return the streams after the track has accepted a frame."""
    stream = streams.get(sensor, Stream())
    return {**streams, sensor: replace(stream, accepted_ns=max(stream.accepted_ns, stamp_ns))}


def begun(streams: Streams, sensor: str = "", stamp_ns: int = 0) -> Streams:
    """Return the streams when a track begins: none supports it but the sensor of its first frame, if any."""
    none = {name: replace(stream, accepted_ns=0) for name, stream in streams.items()}
    return supported(none, sensor, stamp_ns) if sensor else none


def searched(streams: Streams, sensor: str, stamp_ns: int) -> Streams:
    """Return the streams after a frame was searched in vain."""
    return {**streams, sensor: replace(streams.get(sensor, Stream()), searched_ns=stamp_ns)}


def rests(streams: Streams, sensor: str, stamp_ns: int, pause_s: float) -> bool:
    """Return whether a frame is left unsearched, so that searches in vain do not delay another sensor."""
    since_s = (stamp_ns - streams.get(sensor, Stream()).searched_ns) / NANOSECONDS
    return 0.0 <= since_s < pause_s


def supporters(streams: Streams) -> list[str]:
    """Return the sensors of which the present track has accepted a frame, the newest first."""
    names = [name for name, stream in streams.items() if stream.accepted_ns]
    return sorted(names, key=lambda name: (-streams[name].accepted_ns, name))


def silent_since_s(streams: Streams, stamp_ns: int) -> float:
    """Return the time since the newest frame of any sensor, accepted or not, s."""
    return (stamp_ns - max((stream.heard_ns for stream in streams.values()), default=0)) / NANOSECONDS


def unsupported_s(streams: Streams, stamp_ns: int) -> float:
    """Return the time since the newest accepted measurement, s; infinite if there is none."""
    newest_ns = max((stream.accepted_ns for stream in streams.values()), default=0)
    return (stamp_ns - newest_ns) / NANOSECONDS if newest_ns else float("inf")


def is_supported(streams: Streams, stamp_ns: int, *, at_least_s: float, unknown_s: float) -> bool:
    """Return whether the newest measurement of any sensor is new enough.

    Args:
        streams: the sensors' frames.
        stamp_ns: the time.
        at_least_s: age up to which a measurement of a fast sensor is new.
        unknown_s: the same for a sensor whose period is not known yet.
    """
    return any(stream.supports(stamp_ns, at_least_s, unknown_s) for stream in streams.values())
