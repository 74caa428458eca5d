"""``lidar-acceptance``: accepted wrong poses, rejected right ones, and f_MAX on other targets."""

from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
import plotly.graph_objects as go
import polars as pl

from rpod_campaign.engine.campaign import CellResult, Row
from rpod_campaign.engine.report.charts import curve_figure
from rpod_campaign.engine.report.content import Section, Table
from rpod_campaign.engine.report.numbers import NONE, in_world, number, word
from rpod_campaign.engine.report.statistics import quantile, rate
from rpod_campaign.lidar_acceptance.trial import AcceptanceCell
from rpod_pose.ports import Outcome
from rpod_schemas.arrays import FloatArray

Results = Sequence[CellResult[AcceptanceCell]]
Group = tuple[str, float]
"""Name of the model, and range in m."""


MOST_WRONG_ACCEPTED, MOST_RIGHT_REJECTED = 0.02, 0.015
"""Aims of the check: largest shares of accepted wrong poses and of rejected right ones."""
F_MAX_M2 = 0.003
"""Limit f_MAX that the 2015 paper's Table 4 suggests, m2: above all successes but one, below all failures."""
SCORES = {
    "f_CONV": ("f_conv_m2", False),
    "deficit": ("deficit_per_return", False),
    "explained share": ("explained_share", True),
}
"""Column of each score, and whether larger values indicate a better pose."""


def summarise(cell: AcceptanceCell, rows: pl.DataFrame) -> dict[str, Any]:
    """Return the summary of a cell: numbers of trials."""
    checked = rows.filter(pl.col("found").is_not_null())
    wrong, accepted = checked["wrong"], checked["accepted"]
    ambiguous = checked["verdict"] == Outcome.AMBIGUOUS.value
    return {
        **asdict(cell),
        "trials": rows.height,
        "scanned_range_m": quantile(rows["scanned_range_m"], 0.5),
        "without_pose": rows.height - checked.height,
        "wrong": int(wrong.sum()),
        "wrong_accepted": int((wrong & accepted).sum()),
        "right": int((~wrong).sum()),
        "right_rejected": int((~wrong & ~accepted).sum()),
        "right_ambiguous": int((~wrong & ~accepted & ambiguous).sum()),
        "success_rate": rate(int((~wrong).sum()), rows.height).value,
        "ambiguous": int((ambiguous & ~accepted).sum()),
    }


def sections(results: Results) -> list[Section]:
    """Return the sections of the report."""
    groups = _grouped(results)
    return [
        Section(
            "Acceptance",
            "The facility's own check decides on all poses, whatever method found them. Wrong: error of "
            "3 deg or 0.3 m or more, or a scan of another object; trials without a pose do not count. "
            "Rejected: failed, or ambiguous other than by an exact symmetry. Aims: at most "
            f"{100.0 * MOST_WRONG_ACCEPTED:g} % of the wrong accepted, {100.0 * MOST_RIGHT_REJECTED:g} % of "
            "the right rejected. Attitudes are uniform on SO(3). Ranges are for the bulky ENVISAT; those of "
            "other targets are in proportion to their size, the square root of the surface. Shares with "
            "95 % Wilson intervals.",
            (
                _sum_table(results, "Acceptance in all", ("poses of",), _source),
                _sum_table(results, "Acceptance by target and range", ("model", "range, m"), _model),
                _cell_table(results),
            ),
        ),
        Section(
            "f_CONV alone and the likelihood",
            "Shares of accepted right and wrong poses over the limit of one score; crosses are the results "
            "of the check. f_CONV is the paper's: mean squared distance of all points after its ICP from the "
            "checked pose. Deficit: expected minus actual log likelihood for each return. Explained share: "
            "share of agreeing rays, among those for which scan or model have a return.",
            (_score_table(groups),),
            tuple(_figure(groups, target) for target in dict.fromkeys(group[0] for group in groups)),
        ),
    ]


def _source(cell: AcceptanceCell) -> tuple[str, ...]:
    if cell.scanned_target != cell.target:
        return (f"{cell.method}, something else scanned",)
    return (f"{cell.method}, its own target",)


def _model(cell: AcceptanceCell) -> tuple[str, ...]:
    return in_world(cell.target, cell.world), word(cell.range_m)


def _figure(groups: dict[Group, pl.DataFrame], target: str) -> go.Figure:
    """Return the curves of a model's scores, with the results of the check as points."""
    curves, decided = {}, {}
    for (model, range_m), rows in groups.items():
        wrong = rows["wrong"].to_numpy()
        if model != target or not 0 < wrong.sum() < wrong.size:
            continue
        for score in SCORES:
            curves[f"{range_m:g} m, {score}"] = roc(_scores(rows, score), wrong)
        accepted = rows["accepted"].to_numpy()
        decided[f"{range_m:g} m, check"] = float(accepted[wrong].mean()), float(accepted[~wrong].mean())
    return curve_figure(
        curves,
        x_title=f"share of wrong poses accepted, {target}",
        y_title="share of right poses accepted",
        points=decided,
    )


def roc(scores: FloatArray, wrong: Any) -> tuple[list[float], list[float]]:
    """Return the shares of wrong and right poses accepted, as the limit of a score falls.

    Args:
        scores: scores of the poses, larger for better ones, -inf for none; shape (N,).
        wrong: whether a pose is wrong, shape (N,), with both values.
    """
    limits = np.unique(scores[np.isfinite(scores)])[::-1]
    bad, good = np.sort(scores[wrong]), np.sort(scores[~wrong])
    false = 1.0 - np.searchsorted(bad, limits, side="left") / bad.size
    true = 1.0 - np.searchsorted(good, limits, side="left") / good.size
    return [0.0, *false.tolist()], [0.0, *true.tolist()]


def _scores(rows: pl.DataFrame, score: str) -> FloatArray:
    column, larger_is_better = SCORES[score]
    values = rows[column].fill_null(float("nan")).to_numpy().astype(np.float64)
    signed = values if larger_is_better else -values
    return np.where(np.isfinite(signed), signed, -np.inf)


def _area(curve: tuple[list[float], list[float]]) -> float:
    false, true = (np.array([*axis, 1.0]) for axis in curve)
    return float(np.trapezoid(true, false))


def _grouped(results: Results) -> dict[Group, pl.DataFrame]:
    """Return all checked poses by model and range."""
    found: dict[Group, list[pl.DataFrame]] = {}
    for result in results:
        rows = result.rows.filter(pl.col("found").is_not_null())
        found.setdefault((in_world(result.cell.target, result.cell.world), result.cell.range_m), []).append(
            rows
        )
    return {group: pl.concat(frames) for group, frames in found.items()}


_SHARES = ("wrong accepted", "share", "right rejected", "share", "as ambiguous")


def _shares(s: Row) -> tuple[str, ...]:
    return (
        f"{s['wrong_accepted']} of {s['wrong']}",
        str(rate(s["wrong_accepted"], s["wrong"])),
        f"{s['right_rejected']} of {s['right']}",
        str(rate(s["right_rejected"], s["right"])),
        word(s["right_ambiguous"]),
    )


def _cell_table(results: Results) -> Table:
    rows = []
    for result in results:
        cell, s = result.cell, result.summary
        rows.append(
            (
                cell.method,
                word(cell.step_deg),
                in_world(cell.target, cell.world),
                cell.scanned_target,
                word(cell.range_m),
                number(s["scanned_range_m"], ".1f"),
                word(s["trials"]),
                word(s["without_pose"]),
                *_shares(s),
            )
        )
    columns = (
        "method",
        "step, deg",
        "model",
        "scanned",
        "range, m",
        "from, m",
        "trials",
        "no pose",
        *_SHARES,
    )
    return Table("Acceptance in every cell", columns, tuple(rows)).condensed(2)


def _sum_table(
    results: Results, title: str, names: tuple[str, ...], group: Callable[[AcceptanceCell], tuple[str, ...]]
) -> Table:
    """Return the acceptance over all cells of a group, and of all groups."""
    counted = ("wrong_accepted", "wrong", "right_rejected", "right", "right_ambiguous")
    whole = ("all", *("" for _ in names[1:]))
    sums: dict[tuple[str, ...], dict[str, int]] = {}
    for result in results:
        for key in (group(result.cell), whole):
            counts = sums.setdefault(key, dict.fromkeys(counted, 0))
            for name in counted:
                counts[name] += result.summary[name]
    order = [*(key for key in sums if key != whole), whole]
    rows = tuple((*key, *_shares(sums[key])) for key in order if key in sums)
    return Table(title, (*names, *_SHARES), rows)


def _score_table(groups: dict[Group, pl.DataFrame]) -> Table:
    """Return how f_MAX holds for each target and range, and the areas under the curves."""
    rows = []
    for (target, range_m), frame in groups.items():
        wrong = frame["wrong"].to_numpy().astype(np.bool_)
        below = _scores(frame, "f_CONV") >= -F_MAX_M2
        both = 0 < wrong.sum() < wrong.size
        rows.append(
            (
                target,
                word(range_m),
                number(quantile(frame.filter(~pl.col("wrong"))["f_conv_m2"], 1.0), ".4f"),
                number(quantile(frame.filter("wrong")["f_conv_m2"], 0.0), ".4f"),
                str(rate(int((below & wrong).sum()), int(wrong.sum()))),
                str(rate(int((~below & ~wrong).sum()), int((~wrong).sum()))),
                *(
                    number(_area(roc(_scores(frame, score), wrong)), ".4f") if both else NONE
                    for score in SCORES
                ),
            )
        )
    columns = (
        *("model", "range, m", "right, greatest f, m2", "wrong, least f, m2"),
        *("wrong below f_MAX", "right above f_MAX", *(f"area, {score}" for score in SCORES)),
    )
    return Table(f"f_MAX = {F_MAX_M2:g} m2", columns, tuple(rows))
