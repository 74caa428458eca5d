"""``model-matrix``: one table of targets and models."""

from collections.abc import Sequence
from typing import Any

from rpod_campaign.engine.campaign import CellResult
from rpod_campaign.engine.report.content import Section, Table
from rpod_campaign.engine.report.numbers import in_world, millimetres, number
from rpod_campaign.engine.report.statistics import quantile
from rpod_campaign.population.trial import PopulationCell

_COLUMNS = (
    *("target", "model", "counted"),
    *("acquired", "ambiguous", "wrong accepted", "median, deg", "median, mm"),
    *("tracker right", "right and believed", "wrong believed", "median, deg ", "median, mm ", "mean NEES"),
)
"""Columns of the table; those of the tracker follow those of the acquisition."""


def sections(results: Sequence[CellResult[PopulationCell]]) -> list[Section]:
    """Return the table: a row for each target and model."""
    tasks = ("acquisition", "tracking")
    by_task = {task: [result for result in results if result.cell.task == task] for task in tasks}
    rows = [_row(*pair) for pair in zip(*by_task.values(), strict=True)]
    note = (
        "What is seen is the target; what the methods look for is the model. Acquired: right, or ambiguous "
        "with the truth among the hypotheses, within the limits of the campaign population. The tracker "
        "starts with that campaign's error. Errors are the medians over all poses that are found, right or "
        "not, and those to the target's own pose; the NEES is that of right poses."
    )
    return [Section("Targets and models", note, (Table("", _COLUMNS, tuple(rows)),))]


def _row(acquired: CellResult[PopulationCell], tracked: CellResult[PopulationCell]) -> tuple[str, ...]:
    cell, first, then = acquired.cell, acquired.summary, tracked.summary
    right = tracked.rows.filter("seen")["right"].sum()
    return (
        in_world(cell.target, cell.world),
        cell.model.removeprefix(cell.target) or "itself",
        str(first["trials"]),
        number(first["success_rate"], ".2f"),
        str(first["ambiguous"]),
        str(first["wrong_accepted"]),
        *_errors(acquired),
        str(right),
        str(right - then["right_rejected"]),
        str(then["wrong_accepted"]),
        *_errors(tracked),
        number(then["nees_mean"], ".1f"),
    )


def _errors(result: CellResult[Any]) -> tuple[str, str]:
    """Return the median errors of all found poses: attitude, deg, and position, mm."""
    rows = result.rows.filter("seen")
    return (
        number(quantile(rows["attitude_deg"], 0.5), ".2f"),
        millimetres(quantile(rows["position_m"], 0.5)),
    )
