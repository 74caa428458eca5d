"""Handovers from one sensor to another: the time without a measurement, and how far the estimates jump.

A handover is the first accepted frame of a sensor, or its first one after ``PAUSE_S`` without, while frames
of another sensor were accepted less than ``PAUSE_S`` before. A jump is a change of the error between two
successive estimates, from the estimate before the last frame of the other sensor on. Motion does not count.
"""

from itertools import pairwise

import numpy as np

from rpod_analysis.scoring.run import Run
from rpod_schemas.messages import NANOSECONDS
from rpod_schemas.summary import Handover

PAUSE_S = 3.0
"""Time without an accepted frame after which a sensor is handed over to again, s."""
_PAUSE_NS = round(PAUSE_S * NANOSECONDS)

Offset = tuple[int, np.ndarray, np.ndarray]
"""Stamp of an estimate, and its errors: R_est R_truth^T, shape (3, 3), and dp in chaser axes, shape (3,)."""


class Handovers:
    """Finds the handovers of a run, minute by minute."""

    def __init__(self) -> None:
        self._accepted_ns: dict[str, int] = {}
        self._before: list[Offset] = []
        self._gap_s: list[float] = []
        self._jump_m: list[float] = []
        self._jump_deg: list[float] = []

    def take(self, run: Run) -> None:
        """Add a minute of the run."""
        offsets = [*self._before, *_offsets(run)]
        statuses = run.statuses
        used = statuses.accepted & (statuses.sensor != "")
        for sensor, stamp_ns in zip(statuses.sensor[used], statuses.stamp_ns[used].tolist(), strict=True):
            self._use(str(sensor), stamp_ns, offsets)
        newest_ns = offsets[-1][0] if offsets else 0
        self._before = [each for each in offsets if newest_ns - each[0] <= 2 * _PAUSE_NS]

    def _use(self, sensor: str, stamp_ns: int, offsets: list[Offset]) -> None:
        own_ns = self._accepted_ns.get(sensor, stamp_ns - 2 * _PAUSE_NS)
        others_ns = max((ns for name, ns in self._accepted_ns.items() if name != sensor), default=None)
        self._accepted_ns[sensor] = max(stamp_ns, own_ns)
        if others_ns is None or stamp_ns - own_ns <= _PAUSE_NS or abs(stamp_ns - others_ns) > _PAUSE_NS:
            return
        self._gap_s.append(max(stamp_ns - others_ns, 0) / NANOSECONDS)
        first_ns = min(stamp_ns, others_ns)
        before = [each for each in offsets if each[0] < first_ns][-1:]
        window = before + [each for each in offsets if first_ns <= each[0] <= max(stamp_ns, others_ns)]
        for (_, turn, place_m), (_, next_turn, next_m) in pairwise(window):
            cosine = np.clip(0.5 * (np.trace(next_turn @ turn.T) - 1.0), -1.0, 1.0)
            self._jump_deg.append(float(np.degrees(np.arccos(cosine))))
            self._jump_m.append(float(np.linalg.norm(next_m - place_m)))

    def summary(self) -> Handover | None:
        """Return the largest gap and jumps; None if there was no handover."""
        if not self._gap_s:
            return None
        return Handover(
            count=len(self._gap_s),
            gap_s=max(self._gap_s),
            jump_m=max(self._jump_m, default=None),
            jump_deg=max(self._jump_deg, default=None),
        )


def _offsets(run: Run) -> list[Offset]:
    scored = np.flatnonzero(run.errors.scored)
    if not scored.size:
        return []
    estimate, truth = run.estimates.poses[scored], run.T_truth[scored]
    turns = (estimate.rotation * truth.rotation.inv()).as_matrix()
    return list(
        zip(
            run.estimates.stamp_ns[scored].tolist(),
            turns,
            estimate.translation - truth.translation,
            strict=True,
        )
    )
