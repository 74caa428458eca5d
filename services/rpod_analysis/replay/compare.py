"""Comparison of old and new estimates with the truth, and with each other."""

from dataclasses import dataclass

import numpy as np

from rpod_analysis.errors import NoEstimatesError
from rpod_analysis.log import Log, open_log
from rpod_analysis.log.sensors import Sensor, find_sensors
from rpod_analysis.replay.navigate import Replayed
from rpod_analysis.scoring.row_store import Column
from rpod_analysis.scoring.run import Run, read_run
from rpod_analysis.scoring.score import Track
from rpod_analysis.scoring.totals import RunTotals, summarise_size
from rpod_schemas.logs import REPLAY
from rpod_schemas.replay import Difference, Side


@dataclass(frozen=True)
class Compared:
    """Scores of both sides and the difference between them; None where there are no data."""

    old: Side | None
    new: Side | None
    difference: Difference | None


def compare(log: Log, replayed: Replayed) -> Compared:
    """Compare the estimates that a replay wrote with those of its log.

    Errors are given in the axes of the log's sensors.
    """
    sensors = find_sensors(log)
    with open_log(replayed.out) as beside:
        old, new = _run(beside, replayed.prefix, sensors), _run(beside, REPLAY, sensors)
    between = find_difference(old.estimates, new.estimates) if old and new else None
    return Compared(_side(old), _side(new), between)


def find_difference(old: Track, new: Track) -> Difference | None:
    """Return the difference of two tracks at their common stamps; None if there are none."""
    _, mine, theirs = np.intersect1d(old.stamp_ns, new.stamp_ns, return_indices=True)
    if mine.size == 0:
        return None
    first, second = old.poses[mine], new.poses[theirs]
    turn_rad = (first.rotation.inv() * second.rotation).magnitude()
    distance_m = np.linalg.norm(first.translation - second.translation, axis=1)
    same = (first.as_matrix() == second.as_matrix()).all(axis=(1, 2))
    return Difference(
        common=mine.size,
        identical=int(same.sum()),
        attitude_deg=summarise_size(Column(np.rad2deg(np.where(same, 0.0, turn_rad)))),
        position_m=summarise_size(Column(distance_m)),
    )


def _run(log: Log, prefix: str, sensors: dict[str, Sensor]) -> Run | None:
    try:
        return read_run(log, prefix=prefix, sensors=sensors)
    except NoEstimatesError:
        return None


def _side(run: Run | None) -> Side | None:
    if run is None:
        return None
    totals = RunTotals.of(run)
    return Side(
        frames=len(run.statuses),
        estimates=len(run.estimates),
        accepted=totals.accepted,
        lost_s=totals.lost_ns * 1e-9,
        modes=totals.modes(),
        error=totals.error(),
        consistency=totals.consistency(),
        integrity=totals.integrity.summary(),
    )
