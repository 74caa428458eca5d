"""Scores of the navigation while a fault was injected: modes, times to LOST and back, wrong estimates."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from rpod_analysis.scoring.run import Run
from rpod_analysis.scoring.score import BoolArray, IntArray
from rpod_schemas.arrays import FloatArray
from rpod_schemas.faults.injected import InjectedFault
from rpod_schemas.messages import NANOSECONDS
from rpod_schemas.summary import FaultOutcome
from rpod_schemas.types import Mode


@dataclass
class FaultScore:
    """One fault, with its statuses and estimates, which are added in the order of time."""

    fault: InjectedFault
    end_ns: int
    """End of the fault, or of the run."""
    modes: Counter[int] = field(default_factory=Counter)
    """Number of frames during the fault, by mode."""
    lost_ns: int | None = None
    """Stamp of the first frame in LOST or ACQUIRING after the beginning, before the target is tracked
    again."""
    again_ns: int | None = None
    """First accepted frame in TRACKING from the end on."""
    scored: int = 0
    """Number of estimates of tracked frames during the fault whose truth is known."""
    wrong: int = 0
    """Number of those that are off the target."""
    worst_deg: float | None = None
    worst_m: float | None = None

    def take_statuses(self, stamp_ns: IntArray, mode: IntArray, accepted: BoolArray) -> None:
        """Add frames: stamps, modes after them, and whether their measurements were accepted, (N,) each."""
        begin_ns = self.fault.begin_ns
        self.modes.update(mode[(stamp_ns >= begin_ns) & (stamp_ns < self.end_ns)].tolist())
        untracked = np.isin(mode, (Mode.LOST, Mode.ACQUIRING)) & (stamp_ns >= begin_ns)
        if self.again_ns is None:
            again = (stamp_ns >= self.end_ns) & (mode == Mode.TRACKING) & accepted
            if again.any():
                self.again_ns = int(stamp_ns[again][0])
                untracked &= stamp_ns < self.again_ns
            if self.lost_ns is None and untracked.any():
                self.lost_ns = int(stamp_ns[untracked][0])

    def take_errors(
        self, stamp_ns: IntArray, angle_deg: FloatArray, distance_m: FloatArray, wrong: BoolArray
    ) -> None:
        """Add scored estimates of tracked frames: stamps, errors, and whether they are off the target."""
        mine = (stamp_ns >= self.fault.begin_ns) & (stamp_ns < self.end_ns)
        if mine.any():
            self.scored += int(mine.sum())
            self.wrong += int(wrong[mine].sum())
            self.worst_deg = max(self.worst_deg or 0.0, float(angle_deg[mine].max()))
            self.worst_m = max(self.worst_m or 0.0, float(distance_m[mine].max()))

    def outcome(self, start_ns: int) -> FaultOutcome:
        """Return the result; times count from the start of the run."""
        fault, frames = self.fault, self.modes.total()
        return FaultOutcome(
            fault=fault.fault,
            where=fault.where,
            size=fault.size,
            begin_s=(fault.begin_ns - start_ns) / NANOSECONDS,
            end_s=None if fault.end_ns is None else (fault.end_ns - start_ns) / NANOSECONDS,
            frames=frames,
            tracking_share=self.modes[Mode.TRACKING] / frames if frames else None,
            coasting_share=self.modes[Mode.COASTING] / frames if frames else None,
            lost_after_s=None if self.lost_ns is None else (self.lost_ns - fault.begin_ns) / NANOSECONDS,
            tracking_again_s=None if self.again_ns is None else (self.again_ns - self.end_ns) / NANOSECONDS,
            wrong_accepted=self.wrong if self.scored else None,
            worst_deg=self.worst_deg,
            worst_m=self.worst_m,
        )


class FaultScores:
    """All faults of a run, minute by minute."""

    def __init__(self, faults: Iterable[InjectedFault], end_ns: int) -> None:
        self.scores = [
            FaultScore(fault, min(end_ns, end_ns if fault.end_ns is None else fault.end_ns))
            for fault in faults
        ]

    def take(self, run: Run) -> None:
        """Add a minute of the run."""
        tracked = run.tracked & run.errors.scored
        errors, stamp_ns = run.errors.at(tracked), run.estimates.stamp_ns[tracked]
        for score in self.scores:
            score.take_statuses(run.statuses.stamp_ns, run.statuses.mode, run.statuses.accepted)
            angle_deg = np.rad2deg(errors.angle_rad)
            score.take_errors(stamp_ns, angle_deg, errors.distance_m, errors.off_target)

    def outcomes(self, start_ns: int) -> tuple[FaultOutcome, ...]:
        """Return the results in the order of their beginning."""
        return tuple(score.outcome(start_ns) for score in self.scores)
