"""``pmd-acceptance``: right poses that are rejected, and frames of other objects that are accepted."""

from collections.abc import Sequence
from typing import Any

import polars as pl

from rpod_campaign.engine.campaign import CellResult, Row, described
from rpod_campaign.engine.report.content import Section, Table
from rpod_campaign.engine.report.statistics import rate
from rpod_campaign.pmd_acceptance.trial import OFF_DEG, OFF_M, AcceptanceCell

Results = Sequence[CellResult[AcceptanceCell]]
_METHODS = ("acquisition", "tracker")


def summarise(cell: AcceptanceCell, rows: pl.DataFrame) -> dict[str, Any]:
    """Return the summary of a cell: numbers of trials."""
    counts: dict[str, Any] = {}
    for method in _METHODS:
        accepted, right = rows[f"{method}_accepted"], rows[f"{method}_right"]
        alike = rows[f"{method}_alike"].fill_null(value=False)
        counts |= {
            f"{method}_accepted": int(accepted.sum()),
            f"{method}_accepted_alike": int((accepted & alike).sum()),
            f"{method}_right": int(right.sum()),
            f"{method}_right_refused": int((right & ~accepted).sum()),
            f"{method}_wrong_accepted": int((accepted & ~right).sum()),
        }
    counts["ambiguous"] = int(rows["ambiguous"].sum())
    counts["tracked_after"] = int(rows["tracked_after"].sum())
    return {**described(cell), "spoiled": cell.spoiled, "trials": rows.height, **counts}


def sections(results: Results) -> list[Section]:
    """Return the sections of the report."""
    note = (
        "Each trial is one frame with any attitude, any sun, and uncalibrated depth. The acquisition has no "
        f"guess; the tracker starts with an error of {OFF_DEG:g} deg and {1e2 * OFF_M:g} cm. "
    )
    right = [result for result in results if not result.cell.spoiled]
    spoiled = [result for result in results if result.cell.spoiled]
    told = "Right: within 4 deg and 8 cm. Ambiguous results are not accepted. 95 % Wilson intervals."
    alike = (
        "No pose is right. Alike: at the found pose the target has the same ranges and outline as the actual "
        "object, within 3 cm, so that only materials and motion can distinguish the two."
    )
    return [
        *([Section("Right frames", note + told, (_right_table(right),))] if right else []),
        *([Section("Frames of other objects", note + alike, (_spoiled_table(spoiled),))] if spoiled else []),
    ]


def _right_table(results: Results) -> Table:
    rows = [
        (case, method, *_share(s["trials"] - s[f"{method}_accepted"], s), str(s[f"{method}_wrong_accepted"]))
        for case, method, s in _by_method(results)
    ]
    columns = ("case", "method", "not accepted", "share", "wrong accepted")
    return Table("Right frames not accepted", columns, tuple(rows)).condensed(2)


def _spoiled_table(results: Results) -> Table:
    rows = [
        (case, method, *_share(s[f"{method}_accepted"], s), str(s[f"{method}_accepted_alike"]))
        for case, method, s in _by_method(results)
    ]
    columns = ("case", "method", "accepted", "share", "of these alike")
    return Table("Accepted frames of other objects", columns, tuple(rows)).condensed(2)


def _by_method(results: Results) -> list[tuple[str, str, Row]]:
    """Return case, method and summary for each method of each cell."""
    return [(result.cell.case, method, result.summary) for result in results for method in _METHODS]


def _share(count: int, summary: Row) -> tuple[str, str]:
    """Return a count of a cell's trials, and its share with the interval, as texts."""
    return f"{count} of {summary['trials']}", str(rate(count, summary["trials"]))
