"""``lidar-robustness``: acquisition in worlds that differ from the method's assumptions."""

from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import Any

import polars as pl

from rpod_campaign.engine.campaign import CellResult
from rpod_campaign.engine.report.content import Section, Table
from rpod_campaign.engine.report.numbers import in_world, number, word
from rpod_campaign.engine.report.statistics import rate_of
from rpod_campaign.engine.trial.targets import cached_target
from rpod_campaign.lidar.scores import ambiguous, wrong
from rpod_campaign.lidar_robustness.trial import NOMINAL, RobustnessCell

Results = Sequence[CellResult[RobustnessCell]]


def summarise(cell: RobustnessCell, rows: pl.DataFrame) -> dict[str, Any]:
    """Return the summary of a cell; ``right_rejected`` counts the right poses that were not accepted."""
    return {
        **asdict(cell),
        "trials": rows.height,
        **rate_of(rows, "success").named("success_rate"),
        "wrong_accepted": int((wrong(rows, cached_target(cell.target)) & rows["accepted"]).sum()),
        "right_rejected": int((rows["success"] & ~rows["accepted"]).sum()),
        **ambiguous(rows),
    }


def sections(results: Results) -> list[Section]:
    """Return the sections of the report."""
    nominal = {r.cell: rate_of(r.rows, "success").value for r in results if r.cell.disturbance == NOMINAL}
    rows = []
    for result in results:
        cell, share = result.cell, rate_of(result.rows, "success")
        fall = nominal[replace(cell, disturbance=NOMINAL)] - share.value
        rows.append(
            (
                in_world(cell.target, cell.world),
                cell.method,
                word(cell.step_deg),
                word(cell.range_m),
                cell.disturbance,
                str(result.rows.height),
                str(share),
                number(100.0 * fall, "+.1f"),
                f"{result.summary['right_rejected']} of {share.count}",
            )
        )
    columns = ("target", "method", "step, deg", "range, m", "world", "trials", "success")
    table = Table("Success", (*columns, "fall, points", "right rejected"), tuple(rows)).condensed(4)
    note = (
        "The method always assumes the nominal world; all worlds have the same attitudes. Success: attitude "
        "within 3 deg, with 95 % Wilson intervals. Fall: loss of success against nominal in this run, "
        "percentage points. Right rejected: out of the successes."
    )
    return [Section("Robustness", note, (table,))]
