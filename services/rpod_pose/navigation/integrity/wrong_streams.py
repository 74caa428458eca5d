"""Sensors whose stream of frames is wrong as a whole: it is frozen, or its clock was set.

The estimator finds both before it measures a pose: a frozen stream by the content of its frames, a clock by
their stamps and arrivals. It refuses such frames. An estimate without them may be right, but the sensor that
sends them has failed. A clock whose new stamps are steady is believed after a while, since another exposure
looks the same; its frames are used then, and may all be wrong by the same time.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

from rpod_pose.navigation.sensors.streams import is_recent
from rpod_pose.navigation.state import NavigatorState
from rpod_schemas.errors import Reason
from rpod_schemas.messages import NANOSECONDS
from rpod_schemas.types import EstimatorStatus

CLOCK_MOVED_S = "clock_moved_s"
"""Evidence in the status of a frame by which a clock was found to be set, or is believed again: the change of
its stamps against their arrival, s."""


@dataclass(frozen=True)
class Move:
    """A clock whose stamps have moved against the arrival of its frames."""

    stamp_ns: int
    """Newest stamp of the track when a frame showed it last."""
    moved_s: float
    """Change of the stamps, s; negative if the clock was set back."""
    is_refused: bool
    """Whether its frames are refused; if not, they are used with the stamps that have moved."""

    def describe(self, sensor: str, now_ns: int) -> str:
        """Return the finding in words, with its remedy."""
        if self.is_refused:
            return (
                f"{sensor}: its stamps have moved by {self.moved_s:+.3f} s against their arrival; its clock "
                "was set, or runs wrong, and its frames are refused"
            )
        since_s = (now_ns - self.stamp_ns) / NANOSECONDS
        return (
            f"{since_s:.1f} s ago: the stamps of {sensor} have moved by {self.moved_s:+.3f} s against their "
            "arrival, and are steady since: its clock, or its exposure; if they are right, a reset ends this "
            "alert"
        )


@dataclass(frozen=True)
class WrongStreams:
    """Sensors whose frames were frozen, or whose clock was set, not long ago."""

    frozen_ns: Mapping[str, int] = field(default_factory=dict)
    """Stamp of the newest frame of each sensor that sends identical frames."""
    moves: Mapping[str, Move] = field(default_factory=dict)
    """Clocks that were set, by the name of the sensor."""

    def after(
        self,
        state: NavigatorState,
        status: EstimatorStatus,
        *,
        frozen: bool,
        silence_s: float,
        memory_s: float,
    ) -> "WrongStreams":
        """Return the wrong streams after a frame.

        Args:
            state: the navigator's state after it.
            status: its status.
            frozen: whether it was refused because it is identical to the frames before.
            silence_s: time after which a sensor that sends no frames counts as silent.
            memory_s: time for which a clock that has moved is remembered after its frames are used again.
        """
        sensor, now_ns = status.sensor, status.stamp_ns
        frozen_ns = {
            name: stamp_ns
            for name, stamp_ns in self.frozen_ns.items()
            if name != sensor and is_recent(state.streams, name, stamp_ns, now_ns, silence_s)
        }
        if frozen:
            frozen_ns[sensor] = now_ns
        track_ns = now_ns if state.history is None else state.history.state.stamp_ns
        moves = {
            name: move
            for name, move in self.moves.items()
            if (
                name != sensor and is_recent(state.streams, name, move.stamp_ns, track_ns, silence_s)
                if move.is_refused
                else track_ns - move.stamp_ns <= memory_s * NANOSECONDS
            )
        }
        if moved_s := status.evidence.get(CLOCK_MOVED_S):
            is_refused = status.reason.startswith(f"{Reason.CLOCK_STEP}:")
            moves[sensor] = Move(track_ns, moved_s, is_refused)
        return WrongStreams(frozen_ns, moves)

    def alert(self, stamp_ns: int) -> str:
        """Return why an estimate at a stamp must not be used; empty for no reason."""
        if self.frozen_ns:
            named = ", ".join(sorted(self.frozen_ns))
            return f"{named}: frozen, its last frames are identical, or those of an earlier time"
        return "; ".join(move.describe(name, stamp_ns) for name, move in sorted(self.moves.items()))
