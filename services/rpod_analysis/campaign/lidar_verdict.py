"""``lidar-verdict``: wrong poses that are accepted, right ones that are not, and f_MAX on other targets."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
import plotly.graph_objects as go
import polars as pl

from rpod_analysis.campaign.campaign import Campaign, CellResult, Options, Section, Table
from rpod_analysis.campaign.charts import curve_figure
from rpod_analysis.campaign.lidar_cells import methods, steps_of, targets
from rpod_analysis.campaign.statistics import quantile, rate
from rpod_analysis.campaign.trials import judged as trial
from rpod_analysis.campaign.trials.judged import JudgedCell
from rpod_analysis.campaign.trials.scene import cached_target
from rpod_analysis.campaign.trials.scores import exact_turns
from rpod_analysis.campaign.words import number, word
from rpod_estimator.ports import Verdict
from rpod_schemas.arrays import FloatArray

Results = Sequence[CellResult[JudgedCell]]
Group = tuple[str, str, float]
"""Method, target, range in m."""

F_MAX_M2 = 0.003
"""Where the 2015 paper's Table 4 would have it: above all successes but one, below all failures."""
SCORES = {"f_CONV": ("f_conv_m2", False), "explained share": ("explained_share", True)}
"""Scores by column, and whether larger ones speak for a pose."""
_OTHERS = ("envisat-slim", "envisat-bulky", "mockup")
"""What is scanned instead: a target of another size, and another object."""
_TARGETS = ("envisat-slim", "envisat-bulky", "envisat-mesh", "mockup", "rocket-stage")


def cells(options: Options) -> list[JudgedCell]:
    """Return the cells: each method on the target itself, then on scans of others."""
    found = []
    for method in methods(options, ("template-matching", "global", "starved-global")):
        for step_deg in steps_of(method, options):
            for target in targets(options, _TARGETS):
                for scanned in (target, *(other for other in _OTHERS if other != target)):
                    if scanned != target and method == "starved-global":
                        continue
                    found += [
                        JudgedCell(
                            target=target,
                            scanned_target=scanned,
                            method=method,
                            step_deg=step_deg,
                            range_m=range_m,
                        )
                        for range_m in options.ranges or (20.0, 50.0)
                    ]
    return found


def summarise(cell: JudgedCell, rows: pl.DataFrame) -> dict[str, Any]:
    """Return what is said of a cell: numbers of trials."""
    judged = rows.filter(pl.col("found").is_not_null())
    wrong, accepted = judged["wrong"], _answered(cell, judged)
    return {
        **asdict(cell),
        "trials": rows.height,
        "scanned_range_m": quantile(rows["scanned_range_m"], 0.5),
        "without_pose": rows.height - judged.height,
        "wrong": int(wrong.sum()),
        "wrong_accepted": int((wrong & accepted).sum()),
        "right": int((~wrong).sum()),
        "right_rejected": int((~wrong & ~accepted).sum()),
    }


def _answered(cell: JudgedCell, rows: pl.DataFrame) -> pl.Series:
    """Return which poses are accepted; of a target with an exact symmetry, called ambiguous is right."""
    symmetric = len(exact_turns(cached_target(cell.target))) > 1
    return rows["accepted"] | (rows["verdict"].eq(str(Verdict.AMBIGUOUS)) & symmetric)


def sections(results: Results) -> list[Section]:
    """Return the report."""
    groups = _grouped(results)
    return [
        Section(
            "Verdicts",
            "Wrong: 3 deg or 0.3 m off, or of a scan of something else; trials without a pose count for "
            "neither. Attitudes are uniform on SO(3). Ranges are for the bulky ENVISAT; others stand nearer "
            "by their size, the square root of the surface. A model with an exact symmetry is "
            "answered rightly as ambiguous. Shares with 95 % Wilson bounds.",
            (_verdict_table(results), _total_table(results)),
        ),
        Section(
            "f_CONV alone and the share of explained rays",
            "Shares of right and of wrong poses that are accepted as the limit of one score moves; crosses "
            "are the method's own verdicts.",
            (_score_table(groups),),
            tuple(_figure(groups, target) for target in dict.fromkeys(group[1] for group in groups)),
        ),
    ]


def _figure(groups: dict[Group, pl.DataFrame], target: str) -> go.Figure:
    """Return the curves of a model's scores, and where its verdicts stand."""
    curves, verdicts = {}, {}
    for (method, model, range_m), rows in groups.items():
        wrong = rows["wrong"].to_numpy()
        if model != target or not 0 < wrong.sum() < wrong.size:
            continue
        about = f"{method}, {range_m:g} m"
        for score in SCORES:
            curves[f"{about}, {score}"] = roc(_scores(rows, score), wrong)
        answered = rows["answered"].to_numpy()
        verdicts[f"{about}, verdict"] = float(answered[wrong].mean()), float(answered[~wrong].mean())
    return curve_figure(
        curves,
        x_title=f"share of wrong poses accepted, {target}",
        y_title="share of right poses accepted",
        points=verdicts,
    )


def roc(scores: FloatArray, wrong: Any) -> tuple[list[float], list[float]]:
    """Return the shares of wrong and right poses accepted, as the limit of a score falls.

    Args:
        scores: larger ones speak for a pose, -inf where there is none; shape (N,).
        wrong: shape (N,), both kinds present.
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
    """Return the rows of each model and range, whatever was scanned, the starved search with the full one."""
    found: dict[Group, list[pl.DataFrame]] = {}
    for result in results:
        method = result.cell.method.removeprefix("starved-")
        rows = result.rows.with_columns(_answered(result.cell, result.rows).alias("answered"))
        group = method, result.cell.target, result.cell.range_m
        found.setdefault(group, []).append(rows.filter(pl.col("found").is_not_null()))
    return {group: pl.concat(frames) for group, frames in found.items()}


def _verdict_table(results: Results) -> Table:
    rows = []
    for result in results:
        cell, s = result.cell, result.summary
        rows.append(
            (
                cell.method,
                word(cell.step_deg),
                cell.target,
                cell.scanned_target,
                word(cell.range_m),
                number(s["scanned_range_m"], ".1f"),
                word(s["trials"]),
                f"{s['wrong_accepted']} of {s['wrong']}",
                str(rate(s["wrong_accepted"], s["wrong"])),
                f"{s['right_rejected']} of {s['right']}",
                str(rate(s["right_rejected"], s["right"])),
            )
        )
    columns = (
        *("method", "step, deg", "model", "scanned", "range, m", "from, m", "trials"),
        *("wrong accepted", "share", "right rejected", "share"),
    )
    return Table("Verdicts by target and range", columns, tuple(rows)).condensed(2)


def _total_table(results: Results) -> Table:
    """Return the verdicts of each method over all that it was given."""
    sums: dict[str, np.ndarray[Any, np.dtype[np.int64]]] = {}
    for result in results:
        method = result.cell.method.removeprefix("starved-")
        s = result.summary
        counts = np.array([s["wrong_accepted"], s["wrong"], s["right_rejected"], s["right"]])
        sums[method] = sums.get(method, np.zeros(4, np.int64)) + counts
    rows = []
    for method, (accepted, wrong, rejected, right) in sums.items():
        rows.append(
            (
                method,
                f"{accepted} of {wrong}",
                str(rate(int(accepted), int(wrong))),
                f"{rejected} of {right}",
                str(rate(int(rejected), int(right))),
            )
        )
    columns = ("method", "wrong accepted", "share", "right rejected", "share")
    return Table("Verdicts in all", columns, tuple(rows))


def _score_table(groups: dict[Group, pl.DataFrame]) -> Table:
    """Return how f_MAX holds for each target and range, and the areas under the curves."""
    rows = []
    for (method, target, range_m), frame in groups.items():
        wrong = frame["wrong"].to_numpy().astype(np.bool_)
        f_conv = _scores(frame, "f_CONV")
        below = f_conv >= -F_MAX_M2
        areas = (
            [number(_area(roc(_scores(frame, score), wrong)), ".4f") for score in SCORES]
            if 0 < wrong.sum() < wrong.size
            else ["-"] * len(SCORES)
        )
        rows.append(
            (
                method,
                target,
                word(range_m),
                number(quantile(frame.filter(~pl.col("wrong"))["f_conv_m2"], 1.0), ".4f"),
                number(quantile(frame.filter("wrong")["f_conv_m2"], 0.0), ".4f"),
                str(rate(int((below & wrong).sum()), int(wrong.sum()))),
                str(rate(int((~below & ~wrong).sum()), int((~wrong).sum()))),
                *areas,
            )
        )
    columns = (
        *("method", "model", "range, m", "right, greatest f, m2", "wrong, least f, m2"),
        *("wrong below f_MAX", "right above f_MAX", *(f"area, {score}" for score in SCORES)),
    )
    return Table(f"f_MAX = {F_MAX_M2:g} m2", columns, tuple(rows)).condensed(1)


CAMPAIGN: Campaign[JudgedCell] = Campaign(
    name="lidar-verdict",
    title="Verdicts on right and wrong poses",
    trials=200,
    accepts=frozenset({"ranges", "steps", "method", "target"}),
    cells=cells,
    trial=trial.run,
    schema=trial.SCHEMA,
    summarise=summarise,
    sections=sections,
)
