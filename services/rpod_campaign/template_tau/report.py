"""``template-tau``: success and excluded templates over tau."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
import polars as pl

from rpod_campaign.engine.campaign import CellResult
from rpod_campaign.engine.report.charts import curve_figure, rate_figure
from rpod_campaign.engine.report.content import Section, Table
from rpod_campaign.engine.report.numbers import in_world, number, percent, word
from rpod_campaign.engine.report.statistics import Rate, mean, rate_of
from rpod_campaign.template_tau.trial import TAU, TauCell
from rpod_pose.lidar.paper_2015.tau_sweep import TauSweep

Results = Sequence[CellResult[TauCell]]

LOSSES = (0.0, 0.01, 0.05)
"""Largest losses of success that a tau may cause, as shares of the scans."""
_PAPER_TAU = 0.1


def summarise(cell: TauCell, rows: pl.DataFrame) -> dict[str, Any]:
    """Return the summary of a cell; the smallest tau is infinite if no compared value is sufficient."""
    swept = _swept(cell, rows)
    return {
        **asdict(cell),
        "trials": rows["trial"].n_unique(),
        "plain_success_rate": swept.plain_success_share,
        "success_rate": swept.success_share.tolist(),
        "excluded_share": swept.excluded_share.tolist(),
        **{f"smallest_tau_{loss:g}": swept.smallest_tau(loss) for loss in LOSSES},
    }


def sections(results: Results) -> list[Section]:
    """Return the sections of the report."""
    note = (
        "A template is left out if its spread about the boresight differs from the scan's by more than tau, "
        f"relative to the latter (2015 paper, Eq. 3; the paper takes {_PAPER_TAU:g}). Success: attitude "
        "within 3 deg after ICP, with 95 % Wilson intervals; plain: with all templates. The smallest tau is "
        "the least compared value from which on the loss of success is at most a given share of the scans."
    )
    return [Section("Choice of tau", note, (_choice(results), _over_tau(results)), _figures(results))]


def _swept(cell: TauCell, rows: pl.DataFrame) -> TauSweep:
    parts = [rows.filter(pl.col(TAU) == tau) for tau in cell.taus]
    success, excluded, plain = (
        np.array([_mean(part[column].cast(pl.Float64)) for part in parts])
        for column in ("success", "excluded_share", "plain_success")
    )
    return TauSweep(np.array(cell.taus), success, excluded, float(plain[0]))


def _mean(values: pl.Series) -> float:
    found = mean(values)
    return float("nan") if found is None else found


def _choice(results: Results) -> Table:
    rows = [
        (
            *_name(result.cell),
            word(result.summary["trials"]),
            number(result.summary["plain_success_rate"], ".3f"),
            *(number(result.summary[f"smallest_tau_{loss:g}"], "g") for loss in LOSSES),
        )
        for result in results
    ]
    columns = ("trials", "plain success", *(f"loss of {100.0 * loss:g} % or less" for loss in LOSSES))
    return Table("Smallest tau", (*_NAMES, *columns), tuple(rows)).condensed(len(_NAMES))


def _over_tau(results: Results) -> Table:
    rows = [
        (*_name(result.cell), word(tau), str(_success(result, tau)), percent(share))
        for result in results
        for tau, share in zip(result.cell.taus, result.summary["excluded_share"], strict=True)
    ]
    columns = ("tau", "success", "templates left out")
    return Table("Success and templates left out", (*_NAMES, *columns), tuple(rows)).condensed(len(_NAMES))


def _figures(results: Results) -> tuple[Any, ...]:
    success = {
        ", ".join(_name(result.cell)): {tau: _success(result, tau) for tau in result.cell.taus}
        for result in results
    }
    excluded = {
        ", ".join(_name(result.cell)): (result.cell.taus, result.summary["excluded_share"])
        for result in results
    }
    return (
        rate_figure(success, x_title="tau"),
        curve_figure(excluded, x_title="tau", y_title="share of the templates left out"),
    )


def _success(result: CellResult[TauCell], tau: float) -> Rate:
    return rate_of(result.rows.filter(pl.col(TAU) == tau), "success")


_NAMES = ("target", "step, deg", "range, m")


def _name(cell: TauCell) -> tuple[str, ...]:
    return in_world(cell.target, cell.world), word(cell.step_deg), word(cell.range_m)
