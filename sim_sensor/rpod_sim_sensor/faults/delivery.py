"""Faults of delivery: frames and messages that do not come, come late, or come twice."""

import zlib
from dataclasses import replace

import numpy as np

from rpod_sim_sensor.faults.injection import Injection, Outgoing


class Silence(Injection):
    """Nothing is published."""

    fault = "silence"

    def part(self, outgoing: Outgoing, elapsed_s: float) -> list[Outgoing]:  # noqa: ARG002
        """Return nothing."""
        return []


class SlowRate(Injection):
    """Every second frame is left out."""

    fault = "slow_rate"

    def __init__(self, kind: str, seed: int) -> None:
        super().__init__(kind, seed)
        self._stamp_ns, self._frames = -1, 0

    def part(self, outgoing: Outgoing, elapsed_s: float) -> list[Outgoing]:  # noqa: ARG002
        """Return the parts of each second frame."""
        if outgoing.stamp_ns != self._stamp_ns:
            self._stamp_ns = outgoing.stamp_ns
            self._frames += 1
        return [outgoing] if self._frames % 2 else []


class LostFrames(Injection):
    """Frames are left out at random; one in eight by default."""

    fault = "lost_frames"

    def part(self, outgoing: Outgoing, elapsed_s: float) -> list[Outgoing]:  # noqa: ARG002
        """Return the part, or nothing if its frame is lost."""
        return [] if self.random(outgoing).random() < (self.size or 0.0) else [outgoing]


class Stall(Injection):
    """No frames in the second half of each 10 s."""

    fault = "stall"

    def part(self, outgoing: Outgoing, elapsed_s: float) -> list[Outgoing]:
        """Return the part, or nothing during a stall."""
        return [] if elapsed_s % 10.0 >= 5.0 else [outgoing]


class LostMessages(Injection):
    """Messages are lost on the bus at random; one in ten by default."""

    fault = "lost_messages"

    def part(self, outgoing: Outgoing, elapsed_s: float) -> list[Outgoing]:  # noqa: ARG002
        """Return the part, marked where it is lost; parts of a frame are lost one by one."""
        key = [self.seed, outgoing.stamp_ns % 2**62, zlib.crc32(outgoing.topic.name.encode())]
        lot = np.random.default_rng(key).random()
        return [replace(outgoing, lost=bool(lot < (self.size or 0.0)))]


class SlowLink(Injection):
    """Messages queue for up to 1.5 s, then the queue is emptied."""

    fault = "slow_link"

    def part(self, outgoing: Outgoing, elapsed_s: float) -> list[Outgoing]:
        """Return the part with its time in the queue."""
        return [replace(outgoing, delay_s=0.3 * (elapsed_s % 5.0))]


class SecondPublisher(Injection):
    """A second process publishes the same."""

    fault = "second_publisher"

    def part(self, outgoing: Outgoing, elapsed_s: float) -> list[Outgoing]:  # noqa: ARG002
        """Return the part of both publishers."""
        return [outgoing, replace(outgoing, publisher="second")]


class MissingPart(Injection):
    """The camera_info does not come."""

    fault = "missing_part"

    def part(self, outgoing: Outgoing, elapsed_s: float) -> list[Outgoing]:  # noqa: ARG002
        """Return any other part."""
        return [] if outgoing.part == "camera_info" else [outgoing]


INJECTIONS: dict[str, type[Injection]] = {
    each.fault: each
    for each in (
        Silence, SlowRate, LostFrames, Stall, LostMessages, SlowLink, SecondPublisher, MissingPart,
    )
}  # fmt: skip
"""Injections of this module by the fault's name."""
