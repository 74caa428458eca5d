"""``faults``: shares of modes, times to LOST and back, wrong estimates, by kind and size."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import polars as pl

from rpod_analysis.scoring.fault_scores import FaultScore
from rpod_analysis.scoring.score import OFF_TARGET_M, OFF_TARGET_RAD
from rpod_campaign.engine.campaign import TRIAL, CellResult, described
from rpod_campaign.engine.report.content import Section, Table
from rpod_campaign.engine.report.numbers import in_world, number, percent
from rpod_campaign.faults.cell import FaultCell
from rpod_campaign.faults.trial import FRAME
from rpod_schemas.faults import BY_NAME
from rpod_schemas.faults.injected import InjectedFault
from rpod_schemas.summary import FaultOutcome
from rpod_schemas.types import Mode

Results = Sequence[CellResult[FaultCell]]


def summarise(cell: FaultCell, rows: pl.DataFrame) -> dict[str, Any]:
    """Return the summary of a cell: outcomes of its sequences, as a run's summary has them."""
    outcomes = [_outcome(cell, sequence) for sequence in rows.sort(FRAME).partition_by(TRIAL)]
    size = BY_NAME[cell.fault].size
    return {
        **described(cell),
        "unit": size.unit if size else "",
        "sequences": len(outcomes),
        "frames": sum(each.frames for each in outcomes),
        "tracking_share": _mean([each.tracking_share for each in outcomes]),
        "coasting_share": _mean([each.coasting_share for each in outcomes]),
        "lost": sum(each.lost_after_s is not None for each in outcomes),
        "lost_after_s": _median([each.lost_after_s for each in outcomes]),
        "back": sum(each.tracking_again_s is not None for each in outcomes),
        "tracking_again_s": _median([each.tracking_again_s for each in outcomes]),
        "wrong_accepted": sum(each.wrong_accepted or 0 for each in outcomes),
        "worst_deg": _max([each.worst_deg for each in outcomes]),
        "worst_m": _max([each.worst_m for each in outcomes]),
    }


def _outcome(cell: FaultCell, sequence: pl.DataFrame) -> FaultOutcome:
    stamp_ns, mode = sequence["stamp_ns"].to_numpy(), sequence["mode"].to_numpy()
    begin_ns, end_ns = int(sequence["begin_ns"][0]), int(sequence["end_ns"][0])
    score = FaultScore(InjectedFault(cell.fault, cell.sensor, begin_ns, end_ns, cell.size), end_ns)
    score.take_statuses(stamp_ns, mode, sequence["accepted"].to_numpy())
    angle_deg = sequence["attitude_error_deg"].cast(pl.Float64).fill_null(float("nan")).to_numpy()
    distance_m = sequence["position_error_m"].cast(pl.Float64).fill_null(float("nan")).to_numpy()
    tracked = np.isin(mode, (Mode.TRACKING, Mode.COASTING)) & np.isfinite(angle_deg)
    wrong = (np.deg2rad(angle_deg) > OFF_TARGET_RAD) | (distance_m > OFF_TARGET_M)
    score.take_errors(stamp_ns[tracked], angle_deg[tracked], distance_m[tracked], wrong[tracked])
    return score.outcome(int(stamp_ns[0]))


def _known(values: Sequence[float | None]) -> list[float]:
    return [value for value in values if value is not None]


def _mean(values: Sequence[float | None]) -> float | None:
    return float(np.mean(_known(values))) if _known(values) else None


def _median(values: Sequence[float | None]) -> float | None:
    return float(np.median(_known(values))) if _known(values) else None


def _max(values: Sequence[float | None]) -> float | None:
    return max(_known(values), default=None)


def sections(results: Results) -> list[Section]:
    """Return the sections of the report."""
    note = (
        "Shares are of the results during the fault. Lost: sequences whose track went to LOST or "
        "ACQUIRING, and the median time to it; back: those that were in TRACKING again, and the median "
        "time from the end of the fault. Wrong: tracked estimates during the fault that are more than "
        "10 deg or 0.3 m off. stop and kill are of the estimator, which gives no results meanwhile. link_... "
        "are of the link from the sensor to the estimator."
    )
    columns = (
        *("target", "sensor", "fault", "size", "lasts, s", "tracking", "coasting", "lost", "after, s"),
        *("back", "after, s", "wrong", "worst, deg", "worst, m"),
    )
    rows = [
        (
            in_world(each.cell.target, each.cell.world),
            each.cell.sensor,
            each.cell.fault,
            f"{number(each.cell.size, 'g')} {each.summary['unit']}".strip(),
            number(each.cell.end_s - each.cell.start_s, "g"),
            percent(each.summary["tracking_share"]),
            percent(each.summary["coasting_share"]),
            f"{each.summary['lost']} of {each.summary['sequences']}",
            number(each.summary["lost_after_s"], ".2f"),
            f"{each.summary['back']} of {each.summary['sequences']}",
            number(each.summary["tracking_again_s"], ".2f"),
            str(each.summary["wrong_accepted"]),
            number(each.summary["worst_deg"], ".2f"),
            number(each.summary["worst_m"], ".3f"),
        )
        for each in results
    ]
    return [Section("Faults", note, (Table("Faults", columns, tuple(rows)).condensed(2),))]
