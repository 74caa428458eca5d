"""Handovers from one sensor to another: the time without a measurement, and how far the estimates jump.

A handover is the first accepted frame of a sensor, or its first one after ``PAUSE_S`` without an accepted
frame, if a frame of another sensor was accepted less than ``PAUSE_S`` before. Around it, the changes of the
error between successive estimates are compared, from the estimate before the last frame of the other sensor
on. Since errors are compared, motion does not count. A jump is the part of a change beyond the covariance of
the earlier estimate: the length beyond the ellipsoid that contains 95 % of its errors (ICD section 6).
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from rpod_analysis.scoring.run import Run
from rpod_analysis.scoring.score import NEES_95
from rpod_schemas.arrays import FloatArray
from rpod_schemas.messages import NANOSECONDS
from rpod_schemas.summary import Handover

PAUSE_S = 3.0
"""Time without an accepted frame after which a sensor is handed over to again, s."""
_PAUSE_NS = round(PAUSE_S * NANOSECONDS)


class Offset(NamedTuple):
    """An estimate, and its errors in chaser axes."""

    stamp_ns: int
    turn: FloatArray
    """R_est R_truth^T, shape (3, 3)."""
    place_m: FloatArray
    """dp, shape (3,)."""
    covariance: FloatArray
    """Covariance of (dp, dtheta), shape (6, 6)."""

    def change_to(self, later: "Offset") -> tuple[FloatArray, FloatArray]:
        """Return the changes of the errors: of dp, m, and of dtheta, rad, each of shape (3,)."""
        return later.place_m - self.place_m, Rotation.from_matrix(
            later.turn @ self.turn.T, assume_valid=True
        ).as_rotvec()


class AcceptedFrames:
    """Stamps of the last accepted frame of each sensor; frames are added in the order of their results."""

    def __init__(self) -> None:
        self._accepted_ns: dict[str, int] = {}

    def take(self, sensor: str, stamp_ns: int) -> int | None:
        """Add an accepted frame; return the stamp of the frame of another sensor that hands over to it.

        None if the frame is no handover.
        """
        own_ns = self._accepted_ns.get(sensor)
        others_ns = max((ns for name, ns in self._accepted_ns.items() if name != sensor), default=None)
        self._accepted_ns[sensor] = stamp_ns if own_ns is None else max(stamp_ns, own_ns)
        lasts = own_ns is not None and stamp_ns - own_ns <= _PAUSE_NS
        return None if others_ns is None or lasts or abs(stamp_ns - others_ns) > _PAUSE_NS else others_ns


class Handovers:
    """Finds the handovers of a run, minute by minute."""

    def __init__(self) -> None:
        self._accepted = AcceptedFrames()
        self._before: list[Offset] = []
        self._gap_s: list[float] = []
        self._change_m: list[float] = []
        self._change_deg: list[float] = []
        self._jump_m: list[float] = []
        self._jump_deg: list[float] = []

    def take(self, run: Run) -> None:
        """Add a minute of the run."""
        offsets = [*self._before, *_offsets(run)]
        statuses = run.statuses
        used = statuses.accepted & (statuses.sensor != "")
        for sensor, stamp_ns in zip(statuses.sensor[used], statuses.stamp_ns[used].tolist(), strict=True):
            self._use(str(sensor), stamp_ns, offsets)
        newest_ns = offsets[-1].stamp_ns if offsets else 0
        self._before = [each for each in offsets if newest_ns - each.stamp_ns <= 2 * _PAUSE_NS]

    def _use(self, sensor: str, stamp_ns: int, offsets: list[Offset]) -> None:
        others_ns = self._accepted.take(sensor, stamp_ns)
        if others_ns is None:
            return
        self._gap_s.append(max(stamp_ns - others_ns, 0) / NANOSECONDS)
        first_ns = min(stamp_ns, others_ns)
        last_ns = max(stamp_ns, others_ns)
        before = [each for each in offsets if each.stamp_ns < first_ns][-1:]
        window = before + [each for each in offsets if first_ns <= each.stamp_ns <= last_ns]
        for one, other in pairwise(window):
            change_m, change_rad = one.change_to(other)
            if not np.isfinite([*change_m, *change_rad]).all():
                continue
            self._change_m.append(float(np.linalg.norm(change_m)))
            self._change_deg.append(float(np.degrees(np.linalg.norm(change_rad))))
            self._jump_m.append(beyond(change_m, one.covariance[:3, :3]))
            self._jump_deg.append(float(np.degrees(beyond(change_rad, one.covariance[3:, 3:]))))

    def summary(self) -> Handover | None:
        """Return the largest gap and jumps; None if there was no handover."""
        if not self._gap_s:
            return None
        return Handover(
            count=len(self._gap_s),
            gap_s=max(self._gap_s),
            jump_m=max(self._jump_m, default=None),
            jump_deg=max(self._jump_deg, default=None),
            change_m=max(self._change_m, default=None),
            change_deg=max(self._change_deg, default=None),
        )


def beyond(change: FloatArray, covariance: FloatArray) -> float:
    """Return the length by which a change exceeds the 95 % ellipsoid of a covariance; 0 if it is inside.

    Args:
        change: change of an error, shape (3,).
        covariance: covariance of the error before, shape (3, 3), in the square of the change's unit.
    """
    length = float(np.linalg.norm(change))
    variances, axes = np.linalg.eigh(covariance)
    with np.errstate(divide="ignore", invalid="ignore"):  # a direction without variance allows no change
        squared = float(np.nansum((axes.T @ change) ** 2 / variances.clip(0.0)))
    return length * max(0.0, 1.0 - float(np.sqrt(NEES_95[3] / squared))) if squared > 0.0 else 0.0


def _offsets(run: Run) -> list[Offset]:
    scored = np.flatnonzero(run.errors.scored)
    if not scored.size:
        return []
    estimate, truth = run.estimates.poses[scored], run.T_truth[scored]
    turns = (estimate.rotation * truth.rotation.inv()).as_matrix()
    stamps_ns, places_m = run.estimates.stamp_ns[scored].tolist(), estimate.translation - truth.translation
    found = zip(stamps_ns, turns, places_m, run.covariance[scored], strict=True)
    return [Offset(*each) for each in found]
