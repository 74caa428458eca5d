"""``population``: figures of each satellite, and totals with their Wilson intervals."""

from collections.abc import Sequence
from typing import Any

import polars as pl

from rpod_campaign.engine.campaign import CellResult
from rpod_campaign.engine.report.charts import distinct, rate_figure
from rpod_campaign.engine.report.content import Section, Table
from rpod_campaign.engine.report.numbers import in_world, millimetres, milliseconds, number, percent
from rpod_campaign.engine.report.statistics import (
    Rate,
    consistency,
    quantile,
    rate,
    rate_of,
    root_mean_square,
)
from rpod_campaign.population.trial import RIGHT, PopulationCell

Results = Sequence[CellResult[PopulationCell]]
FAR_OFF_DEG = 10.0
"""Attitude error of an accepted pose that is more than a loss of accuracy, deg."""
FEW, LEAST_RETURNS = 60, 6
"""Number of returns below which a scan counts as one of few returns, and the least number of such a scan."""
LARGE_M = 1.0
"""Longest side from which on a satellite is at least 40 standard deviations of the LIDAR's range long, m."""

_SUCCESS = pl.when(pl.col("ambiguous")).then(pl.col("truth_among")).otherwise(pl.col("right"))
_RATES: dict[str, pl.Expr] = {
    "success": _SUCCESS,
    "ambiguous": pl.col("ambiguous"),
    "accepted": pl.col("accepted"),
    "wrong_accepted": pl.col("accepted") & ~pl.col("right"),
    "wrong_accepted_coarse": pl.col("accepted") & ~pl.col("right") & pl.col("coarse"),
    "coarse": pl.col("accepted") & pl.col("coarse"),
    "right_rejected": pl.col("right") & ~pl.col("accepted") & ~pl.col("ambiguous"),
}
"""Conditions whose trials are counted, by name."""


def summarise(cell: PopulationCell, rows: pl.DataFrame) -> dict[str, Any]:
    """Return the summary of a satellite; rates are over the trials whose frame shows enough of it."""
    seen = rows.filter("seen")
    return {
        "body": cell.target,
        "model": cell.model,
        "kind": rows["kind"][0] if rows.height else "",
        "sensor": cell.sensor,
        "task": cell.task,
        "world": cell.world,
        "surroundings": cell.surroundings,
        "size_m": quantile(rows["size_m"], 0.5),
        "triangles": int(rows["triangles"][0]) if rows.height else None,
        "range_m": quantile(seen["range_m"], 0.5),
        "returns": quantile(seen["returns"], 0.5),
        "trials": seen.height,
        "few_pixels": rows.height - seen.height,
        **rate_of(seen, _SUCCESS).named("success_rate"),
        "ambiguous": rate_of(seen, _RATES["ambiguous"]).count,
        "ambiguous_rate": rate_of(seen, _RATES["ambiguous"]).value,
        "wrong_accepted": rate_of(seen, _RATES["wrong_accepted"]).count,
        "wrong_accepted_coarse": rate_of(seen, _RATES["wrong_accepted_coarse"]).count,
        "right_rejected": rate_of(seen, _RATES["right_rejected"]).count,
        **_accuracy(seen),
        "median_s": quantile(seen["took_s"], 0.5),
    }


def totals(results: Results) -> dict[str, Any]:
    """Return the figures of all satellites together: of all trials, and by the number of returns."""
    if not results:
        return {}
    groups: dict[str, pl.Expr] = {"all": pl.lit(value=True)}
    if results[0].cell.sensor == "lidar":
        groups["returns_60_or_more"] = pl.col("returns") >= FEW
        groups["returns_60_or_more_size_1_m_or_more"] = groups["returns_60_or_more"] & (
            pl.col("size_m") >= LARGE_M
        )
        groups["returns_6_to_60"] = pl.col("returns").is_between(LEAST_RETURNS, FEW, closed="left")
    return {name: _total([result.rows.filter(group) for result in results]) for name, group in groups.items()}


def _total(by_satellite: Sequence[pl.DataFrame]) -> dict[str, Any]:
    rows = pl.concat(by_satellite)
    seen = rows.filter("seen")
    accepted, right = seen.filter("accepted"), seen.filter("right")
    means = [_accuracy(each.filter("seen"))["nees_mean"] for each in by_satellite]
    known = [value for value in means if value is not None]
    return {
        "bodies": sum(each.height > 0 for each in by_satellite),
        "trials": seen.height,
        "few_pixels": rows.height - seen.height,
        **{name: rate_of(seen, condition).as_json for name, condition in _RATES.items()},
        "right_that_are_accepted": rate_of(right, pl.col("accepted")).as_json,
        "accepted_more_than_10_deg_off": rate_of(accepted, pl.col("attitude_deg") > FAR_OFF_DEG).as_json,
        **_accuracy(seen),
        "nees_mean_least_body": min(known, default=None),
        "nees_mean_greatest_body": max(known, default=None),
        "median_s": quantile(seen["took_s"], 0.5),
        "p95_s": quantile(seen["took_s"], 0.95),
    }


def _accuracy(rows: pl.DataFrame) -> dict[str, float | None]:
    """Return the errors of the right poses, accepted or not, and their consistency."""
    good = rows.filter("right")
    return {
        "attitude_deg_rms": root_mean_square(good["attitude_deg"]),
        "position_m_rms": root_mean_square(good["position_m"]),
        **consistency(good),
    }


def sections(results: Results) -> list[Section]:
    """Return the sections of the report."""
    if not results:
        return []
    lidar = results[0].cell.sensor == "lidar"
    angle_deg, share = RIGHT[results[0].cell.sensor]
    note = (
        f"Right: within {angle_deg:g} deg and {100.0 * share:g} % of the longest side, modulo exact "
        "symmetries. Success: right, or ambiguous with the truth among the hypotheses. Errors and NEES are "
        "those of right poses, accepted or not. Coarse: accepted, with a position whose covariance exceeds "
        "the limit at three standard deviations. Shares have their 95 % Wilson intervals. "
    )
    apart = "" if lidar else "Frames with fewer than 200 of the target's pixels with depth are counted apart."
    return [
        Section("All satellites", note + apart, (_totals_table(results),)),
        Section("Each satellite", "", (_bodies_table(results),), (_figure(results),)),
    ]


def _totals_table(results: Results) -> Table:
    rows = [
        (
            name.replace("_", " "),
            str(total["trials"]),
            str(total["few_pixels"]),
            *(str(rate(total[key]["count"], total[key]["of"])) for key in _SHARES),
            *_texts(total),
        )
        for name, total in totals(results).items()
    ]
    columns = (
        *("trials", "counted", "too few pixels", "success", "ambiguous", "wrong accepted"),
        *("wrong accepted and coarse", "coarse"),
        *("right that are accepted", "accepted more than 10 deg off", *_ACCURACY),
    )
    return Table("Totals", columns, tuple(rows))


_SHARES = (
    *("success", "ambiguous", "wrong_accepted", "wrong_accepted_coarse", "coarse"),
    *("right_that_are_accepted", "accepted_more_than_10_deg_off"),
)
_ACCURACY = ("RMS, deg", "RMS, mm", "mean NEES", "of", "inside 95 %", "median, ms")


def _texts(summary: dict[str, Any]) -> tuple[str, ...]:
    return (
        number(summary["attitude_deg_rms"], ".2f"),
        millimetres(summary["position_m_rms"]),
        number(summary["nees_mean"], ".2f"),
        number(summary["nees_dof"], ".2g"),
        percent(summary["nees_share_in_95"]),
        milliseconds(summary["median_s"]),
    )


def _bodies_table(results: Results) -> Table:
    rows = []
    for result in results:
        s = dict(result.summary)
        rows.append(
            (
                in_world(s["body"], s["world"], s["surroundings"]),
                s["kind"] or "-",
                number(s["size_m"], ".2f"),
                number(s["triangles"], "d") if s["triangles"] is not None else "-",
                number(s["range_m"], ".1f"),
                number(s["returns"], ".0f"),
                str(s["trials"]),
                str(s["few_pixels"]),
                number(s["success_rate"], ".3f"),
                number(s["ambiguous_rate"], ".3f"),
                str(s["wrong_accepted"]),
                str(s["right_rejected"]),
                *_texts(s),
            )
        )
    columns = (
        *("satellite", "body", "size, m", "triangles", "range, m", "returns", "counted", "too few pixels"),
        *("success", "ambiguous", "wrong accepted", "right rejected", *_ACCURACY),
    )
    return Table("Satellites", columns, tuple(rows))


def _figure(results: Results) -> Any:
    """Return success over size: a line for each kind of body, and for each target without a kind."""
    lines: dict[str, dict[float, Rate]] = {}
    names = [_line(result) for result in results]
    for result, name in zip(results, names, strict=True):
        points = lines.setdefault(distinct(name, names) or name[0], {})
        points[result.summary["size_m"] or 0.0] = rate_of(result.rows.filter("seen"), _SUCCESS)
    return rate_figure(lines, x_title="longest side [m]")


def _line(result: CellResult[PopulationCell]) -> tuple[str, ...]:
    cell = result.cell
    return result.summary["kind"] or cell.target, cell.world, cell.surroundings
