"""Faults of stamps: other clocks, and other instants."""

from collections import deque

import numpy as np

from rpod_schemas.messages import read_info, read_points
from rpod_sim_sensor.faults.content import with_points
from rpod_sim_sensor.faults.injection import Injection, Outgoing, stamped

_SECOND_NS = 1_000_000_000


class Shifted(Injection):
    """Stamps of another clock; ``shift_s`` says by how much it is ahead."""

    def shift_s(self, outgoing: Outgoing, elapsed_s: float) -> float:
        """Return the time by which the clock is ahead, s."""
        raise NotImplementedError

    def part(self, outgoing: Outgoing, elapsed_s: float) -> list[Outgoing]:
        """Return the part under the other clock's stamp."""
        shift_ns = round(self.shift_s(outgoing, elapsed_s) * _SECOND_NS)
        return [stamped(outgoing, outgoing.stamp_ns + shift_ns)]

    def drawn(self, low: float, high: float) -> float:
        """Return a number of this seed, uniform between two limits."""
        return float(np.random.default_rng([self.seed, 0xC10C]).uniform(low, high))


class TaiClock(Shifted):
    """TAI, 37 s ahead of UTC."""

    fault = "tai_clock"

    def shift_s(self, outgoing: Outgoing, elapsed_s: float) -> float:  # noqa: ARG002
        """Return 37 s."""
        return 37.0


class LocalTime(Shifted):
    """Local time, 1 to 12 h east of Greenwich."""

    fault = "local_time"

    def shift_s(self, outgoing: Outgoing, elapsed_s: float) -> float:  # noqa: ARG002
        """Return whole hours."""
        return 3600.0 * (1 + int(self.drawn(0.0, 12.0)))


class BootClock(Shifted):
    """Time from the start of the device, 20 to 2000 s ago."""

    fault = "boot_clock"

    def shift_s(self, outgoing: Outgoing, elapsed_s: float) -> float:
        """Return the time since 1970, less that since the start."""
        return self.drawn(20.0, 2000.0) + elapsed_s - outgoing.stamp_ns / _SECOND_NS


class ClockAhead(Shifted):
    """A clock that is ahead; by 0.2 to 5 s by default."""

    fault = "clock_ahead"

    def shift_s(self, outgoing: Outgoing, elapsed_s: float) -> float:  # noqa: ARG002
        """Return the offset."""
        return self.drawn(0.2, 5.0) if self.size is None else self.size


class ClockBehind(Shifted):
    """A clock that is behind; by 1.5 to 10 s by default."""

    fault = "clock_behind"

    def shift_s(self, outgoing: Outgoing, elapsed_s: float) -> float:  # noqa: ARG002
        """Return the offset."""
        return -(self.drawn(1.5, 10.0) if self.size is None else self.size)


class ClockDrift(Shifted):
    """A clock that is 300 to 1000 ppm too slow."""

    fault = "clock_drift"

    def shift_s(self, outgoing: Outgoing, elapsed_s: float) -> float:  # noqa: ARG002
        """Return the offset since the fault's start."""
        return -elapsed_s * self.drawn(3e-4, 1e-3)


class StampJitter(Shifted):
    """Stamps up to 20 % of a period, and at least 5 ms, too late."""

    fault = "stamp_jitter"

    def __init__(self, kind: str, seed: int) -> None:
        super().__init__(kind, seed)
        self._stamps_ns: deque[int] = deque(maxlen=2)

    def shift_s(self, outgoing: Outgoing, elapsed_s: float) -> float:  # noqa: ARG002
        """Return a random time, the same for all parts of a frame."""
        if outgoing.stamp_ns not in self._stamps_ns:
            self._stamps_ns.append(outgoing.stamp_ns)
        period_s = (max(self._stamps_ns) - min(self._stamps_ns)) / _SECOND_NS
        return float(self.random(outgoing).uniform(0.0, max(0.2 * period_s, 5e-3)))


class RepeatedStamps(Injection):
    """Each fifth frame carries the stamp of the one before."""

    fault = "repeated_stamps"

    def __init__(self, kind: str, seed: int) -> None:
        super().__init__(kind, seed)
        self._given: dict[int, int] = {}
        self._last_ns, self._frames = 0, 0

    def part(self, outgoing: Outgoing, elapsed_s: float) -> list[Outgoing]:  # noqa: ARG002
        """Return the part under its frame's stamp."""
        stamp_ns = outgoing.stamp_ns
        if stamp_ns not in self._given:
            self._frames += 1
            self._given = {stamp_ns: self._last_ns if self._frames % 5 == 0 else stamp_ns}
            self._last_ns = stamp_ns
        return [stamped(outgoing, self._given[stamp_ns])]


class ReorderedStamps(Injection):
    """Each fifth frame carries a stamp that is older than the last one."""

    fault = "reordered_stamps"

    def __init__(self, kind: str, seed: int) -> None:
        super().__init__(kind, seed)
        self._stamps_ns: deque[int] = deque(maxlen=3)
        self._frames = 0

    def part(self, outgoing: Outgoing, elapsed_s: float) -> list[Outgoing]:  # noqa: ARG002
        """Return the part; in each fifth frame, under an older stamp."""
        if outgoing.stamp_ns not in self._stamps_ns:
            self._frames += 1
            self._stamps_ns.append(outgoing.stamp_ns)
        if self._frames % 5 or len(self._stamps_ns) < 3:
            return [outgoing]
        return [stamped(outgoing, sum(list(self._stamps_ns)[:2]) // 2)]


class StampStart(Injection):
    """Stamps of the start of the exposure or scan, whose duration the sensor's info states."""

    fault = "stamp_start"

    def __init__(self, kind: str, seed: int) -> None:
        super().__init__(kind, seed)
        self._duration_s = 0.0

    def announcement(self, outgoing: Outgoing) -> list[Outgoing]:
        """Learn the duration."""
        if outgoing.part == "info":
            self._duration_s = read_info(outgoing.message).duration_s
        return [outgoing]

    def part(self, outgoing: Outgoing, elapsed_s: float) -> list[Outgoing]:  # noqa: ARG002
        """Return the part with the earlier stamp; times of points count from it."""
        half_s = self._duration_s / 2.0
        if outgoing.part == "points" and "t" in read_points(outgoing.message):
            later = np.float32(half_s)
            outgoing = with_points(outgoing, lambda fields: fields | {"t": fields["t"] + later})
        return [stamped(outgoing, outgoing.stamp_ns - round(half_s * _SECOND_NS))]


class UnpairedParts(Injection):
    """All parts but the leading one are stamped 5 ms later."""

    fault = "unpaired_parts"

    def part(self, outgoing: Outgoing, elapsed_s: float) -> list[Outgoing]:  # noqa: ARG002
        """Return the part under its own stamp."""
        leads = outgoing.part == self.leading
        return [outgoing if leads else stamped(outgoing, outgoing.stamp_ns + 5_000_000)]


INJECTIONS: dict[str, type[Injection]] = {
    each.fault: each
    for each in (
        TaiClock, LocalTime, BootClock, ClockAhead, ClockBehind, ClockDrift, StampJitter, RepeatedStamps,
        ReorderedStamps, StampStart, UnpairedParts,
    )
}  # fmt: skip
"""Injections of this module by the fault's name."""
