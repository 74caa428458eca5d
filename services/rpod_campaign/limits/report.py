"""``limits``: each limit, today and derived, and what it does to right and wrong poses."""

from collections import defaultdict
from collections.abc import Sequence
from typing import Any

import numpy as np
import polars as pl

from rpod_campaign.engine.campaign import CellResult
from rpod_campaign.engine.report.content import Section, Table
from rpod_campaign.engine.report.numbers import number
from rpod_campaign.engine.report.statistics import Rate, quantile, rate
from rpod_campaign.limits.derivation import Derived, derived, refused
from rpod_campaign.limits.trial import START, UNAIDED, LimitsCell, input_of
from rpod_schemas.config.tuning import limits_in

Results = Sequence[CellResult[LimitsCell]]


def summarise(cell: LimitsCell, rows: pl.DataFrame) -> dict[str, Any]:
    """Return the numbers of a satellite's poses."""
    seen = rows.filter("seen")
    return {
        "body": cell.target,
        "sensor": cell.sensor,
        "world": cell.world,
        "range_m": quantile(seen["range_m"], 0.5),
        "returns": quantile(seen["returns"], 0.5),
        "frames": seen["trial"].n_unique() if seen.height else 0,
        "right": int(seen["right"].sum()),
        "wrong": int((~seen["right"]).sum()),
    }


def totals(results: Results) -> dict[str, Any]:
    """Return each limit by its path in the method's configuration, and what all do together."""
    if not results:
        return {}
    cell, found = results[0].cell, _derived(results)
    right, wrong = _right(results), _wrong(results)
    return {
        "sensor": cell.sensor,
        "seed": cell.seed,
        "quantile": cell.quantile,
        "margin": cell.margin,
        "worlds": sorted({result.cell.world for result in results}),
        "bodies": _bodies(results),
        "frames": sum(result.summary["frames"] for result in results),
        "limits": {
            each.field.path: {
                "evidence": each.field.limit.evidence,
                "today": each.field.value,
                "derived": each.value,
                "low": each.low,
                "high": each.high,
                "quantile": each.quantile,
                "right": each.right,
                "bodies": each.bodies,
                **{name: share.as_json for name, share in _effect(each, found, right, wrong).items()},
            }
            for each in found
        },
        "most_doubted_share": max(_refused_shares(right, found), default=float("nan")),
        "together": {
            name: {
                f"{kind}_{what}": _share(
                    _refused_by_any(rows, found, today=today, warned=what == "doubted")
                ).as_json
                for kind, rows in (("right", right), ("wrong", wrong))
                for what in ("refused", "doubted")
            }
            for name, today in (("today", True), ("derived", False))
        },
    }


def sections(results: Results) -> list[Section]:
    """Return the sections of the report."""
    if not results:
        return []
    cell, found = results[0].cell, _derived(results)
    right, wrong = _right(results), _wrong(results)
    note = (
        f"{_bodies(results)} satellites, seed {cell.seed}. A limit is the value that {cell.quantile:.1%} of "
        f"the right poses meet, widened by {cell.margin:.0%}; one that only warns has a share of its own and "
        "no margin. The interval is that over random choices of the satellites. Alone: refused by no other "
        "derived limit. A limit that refuses no wrong pose alone decides nothing."
    )
    rows = []
    for each in found:
        effect = _effect(each, found, right, wrong)
        rows.append(
            (
                each.field.path,
                each.field.limit.evidence,
                number(each.field.value),
                number(each.value),
                f"{number(each.low)} to {number(each.high)}",
                f"{each.quantile:.1%}",
                f"{each.right} of {each.bodies}",
                *(str(effect[name]) for name in _EFFECTS),
            )
        )
    columns = (
        *("limit", "evidence", "today", "derived", "95 %", "quantile", "right poses of satellites"),
        *("right refused", "wrong refused today", "wrong refused", "wrong refused alone"),
    )
    kinds = Table(
        "Shares at which no track begins: any limit refuses, or warns",
        ("poses", "number", "today", "derived"),
        tuple(_kind_rows(right, wrong, found)),
    )
    return [Section("Limits", note, (Table("", columns, tuple(rows)), kinds))]


_EFFECTS = ("right_refused", "wrong_refused_today", "wrong_refused", "wrong_refused_alone")


def _derived(results: Results) -> list[Derived]:
    """Return the limits of the tracker whose poses are checked."""
    cell, by_body = results[0].cell, defaultdict[str, list[pl.DataFrame]](list)
    for result in results:
        by_body[result.cell.target].append(result.rows)
    rows = [pl.concat(several) for several in by_body.values()]
    return [
        derived(field, rows, quantile=cell.quantile, margin=cell.margin)
        for field in limits_in(input_of(cell.sensor).tracking)
    ]


def _bodies(results: Results) -> int:
    return len({result.cell.target for result in results})


def _right(results: Results) -> pl.DataFrame:
    """Return the right poses that the tracker reached without help."""
    return _seen(results).filter("right", pl.col(START).is_in(UNAIDED))


def _wrong(results: Results) -> pl.DataFrame:
    """Return the wrong poses."""
    return _seen(results).filter(~pl.col("right"))


def _seen(results: Results) -> pl.DataFrame:
    named = [result.rows.with_columns(body=pl.lit(result.cell.target)) for result in results]
    return pl.concat(named).filter("seen")


def _effect(
    one: Derived, found: Sequence[Derived], right: pl.DataFrame, wrong: pl.DataFrame
) -> dict[str, Rate]:
    """Return the shares of right and wrong poses that a limit refuses."""
    by_it = refused(wrong, one.field, one.value)
    by_others = _refused_by_any(wrong, [each for each in found if each is not one], today=False)
    return {
        "right_refused": _share(refused(right, one.field, one.value)),
        "wrong_refused_today": _share(refused(wrong, one.field, one.field.value)),
        "wrong_refused": _share(by_it),
        "wrong_refused_alone": _share(by_it & ~by_others),
    }


def _refused_by_any(
    rows: pl.DataFrame, found: Sequence[Derived], *, today: bool, warned: bool = False
) -> pl.Series:
    """Return which poses at least one limit refuses; with ``warned``, also those of which a limit warns.

    No track begins at a pose that is refused or warned of.
    """
    by_any = pl.Series(np.zeros(rows.height, bool))
    for each in found:
        if warned or each.field.limit.usual is None:
            by_any |= refused(rows, each.field, each.field.value if today else each.value)
    return by_any


def _refused_shares(right: pl.DataFrame, found: Sequence[Derived]) -> list[float]:
    """Return for each satellite the share of its right poses that a limit refuses, or warns of."""
    doubted = right.select("body", doubted=_refused_by_any(right, found, today=False, warned=True))
    shares = doubted.group_by("body").agg(pl.mean("doubted"))
    return shares["doubted"].to_list()


def _kind_rows(right: pl.DataFrame, wrong: pl.DataFrame, found: Sequence[Derived]) -> list[tuple[str, ...]]:
    """Return a row for the right poses, and one for the wrong poses of each start."""
    groups = [("right", right)]
    groups += [
        (f"wrong, from {name}", wrong.filter(pl.col(START) == name)) for name in wrong[START].unique().sort()
    ]
    return [
        (
            name,
            str(rows.height),
            *(str(_share(_refused_by_any(rows, found, today=today, warned=True))) for today in (True, False)),
        )
        for name, rows in groups
    ]


def _share(which: pl.Series) -> Rate:
    return rate(int(which.sum()), which.len())
