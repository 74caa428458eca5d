"""Totals of a run, added up minute by minute: exact for any length, in bounded memory.

Source: ICD section 1 ("Errors") and section 6 (``summary.json``).
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rpod_analysis.scoring.fault_scores import FaultScores
from rpod_analysis.scoring.frame_errors import NamedFrame, frame_errors
from rpod_analysis.scoring.handover import Handovers
from rpod_analysis.scoring.integrity import IntegrityTotals
from rpod_analysis.scoring.row_store import Column
from rpod_analysis.scoring.run import Run, Statuses
from rpod_analysis.scoring.score import NEES_95, Errors, IntArray
from rpod_schemas.arrays import FloatArray
from rpod_schemas.messages import NANOSECONDS
from rpod_schemas.summary import (
    Consistency,
    Durations,
    ErrorSize,
    ErrorSummary,
    FrameError,
    Innovation,
    Tracking,
    TruthError,
)
from rpod_schemas.texts import without_figures
from rpod_schemas.types import Mode

_MOST_KINDS = 200
_MOST_CHANGES = 12
_OTHERS = "other reasons"
_AXES = ("roll_deg", "pitch_deg", "yaw_deg", "x_m", "y_m", "z_m")


_ACCEPTED = {
    (Mode.ACQUIRING, Mode.VERIFYING): "a first pose was found",
    (Mode.ACQUIRING, Mode.TRACKING): "a first pose was found and verified",
    (Mode.VERIFYING, Mode.TRACKING): "the next frames agree with the pose",
    (Mode.TRACKING, Mode.COASTING): "frames leave a direction open, and its sigma passed the alert limit",
    (Mode.COASTING, Mode.TRACKING): "a measurement agrees with the prediction",
    (Mode.LOST, Mode.VERIFYING): "the target was found again",
    (Mode.TRACKING, Mode.VERIFYING): "the track was lost and begun again by one frame",
    (Mode.COASTING, Mode.VERIFYING): "the track was lost and begun again by one frame",
}
"""Meaning of a frame's accepted measurement for a change of the navigator's state."""


@dataclass(frozen=True)
class Change:
    """A change of the navigator's state."""

    time_s: float
    """Time from the start of the run."""
    before: Mode
    after: Mode
    reason: str
    """Reason in the status of that frame; empty if its measurement was accepted."""

    @property
    def explanation(self) -> str:
        """Reason in words: that of the status, else what an accepted measurement means for this change."""
        return self.reason or _ACCEPTED.get((self.before, self.after), "a measurement was accepted")


@dataclass(frozen=True)
class Worst:
    """The largest error of the tracked frames."""

    value: float
    time_s: float
    """Time from the start of the run."""


class Kinds:
    """Counts of texts; texts that differ only in their numbers are one kind."""

    def __init__(self) -> None:
        self._counts: Counter[str] = Counter()

    def add(self, text: str) -> None:
        """Count a text."""
        kind = without_figures(text)
        known = kind in self._counts or len(self._counts) < _MOST_KINDS
        self._counts[kind if known else _OTHERS] += 1

    def __len__(self) -> int:
        return self._counts.total()

    def most_common(self, number: int) -> list[tuple[str, int]]:
        """Return the most frequent kinds with their numbers."""
        return self._counts.most_common(number)


class RunTotals:
    """Totals of a run, added minute by minute or for the whole run."""

    def __init__(
        self, frames: Mapping[str, NamedFrame] | None = None, faults: FaultScores | None = None
    ) -> None:
        self.faults = faults or FaultScores((), 0)
        """Scores of the injected faults."""
        self.estimates = self.accepted = self.rejected = self.unscored = 0
        self._time_ns = self._tracked_ns = 0
        self._gap_ns = self._longest_gap_ns = 0
        self.lost_ns = 0
        """Time in LOST or ACQUIRING after the first TRACKING, ns. A mode lasts until the next status; if that
        one tells that the track was lost before it, this time counts as LOST."""
        self.latency_s, self.processing_s, self.nis = Column(), Column(), Column()
        self.dof = 6
        """Degrees of freedom of NEES and NIS."""
        self.nees = Column()
        """NEES of the tracked frames; all errors below are of the tracked frames too."""
        self.reasons = Kinds()
        """Reasons of the rejected frames."""
        self.changes: list[Change] = []
        """Changes of the navigator's state; the first ones only."""
        self.change_count = 0
        self.by_sensor: dict[str, Counter[str]] = {}
        """Numbers of accepted and rejected frames, by sensor."""
        self.worst_deg: Worst | None = None
        self.worst_m: Worst | None = None
        self._first_tracking_s: float | None = None
        self._since = self._tracking_since = self._coasting_since = 0
        self._scored = self._off_target = 0
        self._angle_deg, self._distance_m = Column(), Column()
        self._axes = {name: Column() for name in _AXES}
        self._truth_deg, self._truth_m = Column(), Column()
        self._frames = {name: (frame, Column(), Column()) for name, frame in (frames or {}).items()}
        self.integrity = IntegrityTotals()
        self._last: tuple[int, int] | None = None
        self.handovers = Handovers()
        """Handovers from one sensor to another."""

    @classmethod
    def of(
        cls, *runs: Run, frames: Mapping[str, NamedFrame] | None = None, faults: FaultScores | None = None
    ) -> "RunTotals":
        """Return the totals of runs, which are the minutes of one run in their order.

        Args:
            runs: the minutes.
            frames: frames of the target, at which errors are scored too.
            faults: scores of the faults that were injected.
        """
        totals = cls(frames, faults)
        for run in runs:
            totals.take(run)
        return totals

    @property
    def statuses(self) -> int:
        """Number of frames with a status."""
        return self.accepted + self.rejected

    def take(self, run: Run) -> None:
        """Add a minute of the run."""
        self.dof = run.errors.nees_dof
        self.estimates += len(run.estimates)
        self.unscored += int((~run.errors.scored).sum())
        self.latency_s.extend(run.latency_s[np.unique(run.estimates.stamp_ns, return_index=True)[1]])
        self.processing_s.extend(run.statuses.processing_s)
        self.nis.extend(run.statuses.nis)
        self.integrity.take(run.integrity, run.estimates.stamp_ns, run.errors)
        self._take_outcomes(run.statuses)
        self._take_modes(run)
        self._take_errors(run)
        self.handovers.take(run)
        self.faults.take(run)

    def _take_outcomes(self, statuses: Statuses) -> None:
        accepted = statuses.accepted
        self.accepted += int(accepted.sum())
        self.rejected += int((~accepted).sum())
        for reason in statuses.reason[~accepted]:
            self.reasons.add(str(reason) or "no reason given")
        for sensor in np.unique(statuses.sensor):
            mine = accepted[statuses.sensor == sensor]
            counts = self.by_sensor.setdefault(str(sensor), Counter())
            counts["accepted"] += int(mine.sum())
            counts["rejected"] += int((~mine).sum())

    def _take_modes(self, run: Run) -> None:
        statuses = run.statuses
        if not len(statuses):
            return
        order, newest_ns = statuses.by_arrival()
        modes, reasons = statuses.mode[order], statuses.reason[order]
        tracking = modes == Mode.TRACKING
        if self._first_tracking_s is None and tracking.any():
            first = int(np.argmax(tracking))
            self._first_tracking_s = float(run.seconds(newest_ns)[first])
            since = modes[first:]
        else:
            since = modes
        if self._first_tracking_s is not None:
            self._since += since.size
            self._tracking_since += int((since == Mode.TRACKING).sum())
            self._coasting_since += int((since == Mode.COASTING).sum())
        earlier = [self._last] if self._last else []
        stamp_ns = np.array([stamp for stamp, _ in earlier] + newest_ns.tolist(), np.int64)
        mode = np.array([mode for _, mode in earlier] + modes.tolist(), np.int64)
        self._last = int(stamp_ns[-1]), int(mode[-1])
        held = np.where(statuses.lost_before[order][1 - len(earlier) :], Mode.LOST, mode[:-1])
        self._take_times(np.diff(stamp_ns), held == Mode.TRACKING)
        self._take_lost(run.seconds(stamp_ns)[:-1], np.diff(stamp_ns), held)
        for index in np.flatnonzero(np.diff(mode)) + 1:
            self.change_count += 1
            if len(self.changes) < _MOST_CHANGES:
                self.changes.append(
                    Change(
                        time_s=float(run.seconds(stamp_ns)[index]),
                        before=Mode(mode[index - 1]),
                        after=Mode(mode[index]),
                        reason=str(reasons[index - len(earlier)]),
                    )
                )

    def _take_times(self, held_ns: IntArray, tracking: NDArray[np.bool_]) -> None:
        """Add the times for which modes were held, and find the longest without a track."""
        self._time_ns += int(held_ns.sum())
        self._tracked_ns += int(held_ns[tracking].sum())
        for time_ns, tracked in zip(held_ns.tolist(), tracking, strict=True):
            self._gap_ns = 0 if tracked else self._gap_ns + time_ns
            self._longest_gap_ns = max(self._longest_gap_ns, self._gap_ns)

    def _take_lost(self, time_s: FloatArray, held_ns: IntArray, mode: IntArray) -> None:
        if self._first_tracking_s is not None:
            lost = np.isin(mode, (Mode.LOST, Mode.ACQUIRING)) & (time_s >= self._first_tracking_s)
            self.lost_ns += int(held_ns[lost].sum())

    def _take_errors(self, run: Run) -> None:
        tracked = run.tracked & run.errors.scored
        errors = run.errors.at(tracked)
        angle_deg, distance_m = np.rad2deg(errors.angle_rad), errors.distance_m
        self.nees.extend(run.errors.nees[run.tracked])
        self._scored += len(errors.nees)
        self._off_target += int(errors.off_target.sum())
        self._angle_deg.extend(angle_deg)
        self._distance_m.extend(distance_m)
        for column, values in zip(self._axes.values(), _by_axis(errors), strict=True):
            column.extend(values)
        if errors.truth_covariance is not None:
            variance = np.diagonal(errors.truth_covariance, axis1=1, axis2=2)
            self._truth_m.extend(np.sqrt(variance[:, :3].sum(axis=1)))
            self._truth_deg.extend(np.rad2deg(np.sqrt(variance[:, 3:].sum(axis=1))))
        for frame, at_frame_deg, at_frame_m in self._frames.values() if tracked.any() else ():
            deg, m = frame_errors(frame, run.estimates.poses[tracked], run.T_truth[tracked])
            at_frame_deg.extend(deg)
            at_frame_m.extend(m)
        time_s = run.seconds(run.estimates.stamp_ns[tracked])
        self.worst_deg = _worse(self.worst_deg, angle_deg, time_s)
        self.worst_m = _worse(self.worst_m, distance_m, time_s)

    # --- results ---

    def modes(self) -> Tracking:
        """Return the shares of the modes, and the share of large errors."""
        return Tracking(
            tracked_time_share=self._tracked_ns / self._time_ns if self._time_ns else None,
            longest_untracked_s=self._longest_gap_ns / NANOSECONDS if self._time_ns else None,
            first_tracking_s=self._first_tracking_s,
            tracking_share=self._tracking_since / self._since if self._since else None,
            coasting_share=self._coasting_since / self._since if self._since else None,
            worse_than_10deg_or_0_3m_share=self._off_target / self._scored if self._scored else None,
        )

    def error(self) -> ErrorSummary | None:
        """Return the statistics of the errors over the tracked frames; None if there are none."""
        if not self._scored:
            return None
        return ErrorSummary(
            attitude_deg=summarise_size(self._angle_deg),
            position_m=summarise_size(self._distance_m),
            **{f"{name}_rms": column.rms for name, column in self._axes.items()},
        )

    def truth_error(self) -> TruthError | None:
        """Return how much of the errors may be the truth's; None for a truth that states no covariance."""
        if not self._truth_m.count or self._truth_m.max == 0.0 == self._truth_deg.max:
            return None
        return TruthError(
            attitude_deg_rms=self._truth_deg.rms,
            position_m_rms=self._truth_m.rms,
            attitude_share=_share(self._truth_deg, self._angle_deg),
            position_share=_share(self._truth_m, self._distance_m),
        )

    def frame_errors(self) -> dict[str, FrameError]:
        """Return the statistics of the errors at the target's frames over the tracked frames, by name."""
        return {
            name: FrameError(attitude_deg=summarise_size(deg), position_m=summarise_size(m))
            for name, (_, deg, m) in self._frames.items()
            if m.count
        }

    def consistency(self) -> Consistency | None:
        """Return whether the covariance fits the errors, by the NEES; None if no NEES is known."""
        if not self.nees.count:
            return None
        within = self.nees.share_up_to(NEES_95[self.dof])
        return Consistency(nees_mean=self.nees.mean, nees_dof=self.dof, nees_share_in_95=within)

    def innovation(self) -> Innovation | None:
        """Return whether the covariance fits the innovations, by the NIS; None if no NIS is known."""
        if not self.nis.count:
            return None
        within = self.nis.share_up_to(NEES_95[self.dof])
        return Innovation(nis_mean=self.nis.mean, nis_dof=self.dof, nis_share_in_95=within)


def _share(truth: Column, error: Column) -> float:
    """Return the part of the mean squared error that the truth's own may be, at most 1."""
    return min(1.0, (truth.rms / error.rms) ** 2) if error.rms > 0.0 else 1.0


def summarise_size(values: Column) -> ErrorSize:
    """Return the statistics of at least one error."""
    return ErrorSize(rms=values.rms, p95=values.quantile(0.95), max=values.max)


def summarise_durations(seconds: Column) -> Durations | None:
    """Return median, 99th percentile and maximum of durations; None if there are none."""
    if not seconds.count:
        return None
    return Durations(p50=seconds.quantile(0.5), p99=seconds.quantile(0.99), max=seconds.max)


def _by_axis(errors: Errors) -> list[FloatArray]:
    return [*np.rad2deg(errors.attitude_rad).T, *errors.position_m.T]


def _worse(before: Worst | None, values: FloatArray, time_s: FloatArray) -> Worst | None:
    if not values.size or (before and values.max() <= before.value):
        return before
    index = int(np.argmax(values))
    return Worst(float(values[index]), float(time_s[index]))
