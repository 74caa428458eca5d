"""``pmd-robustness``: a mock-up that is not as drawn, depth that is lost, glints, and the last metre."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import polars as pl

from rpod_campaign.engine.campaign import Campaign, CellResult, Options, Section, Table
from rpod_campaign.engine.numbers import number
from rpod_campaign.engine.statistics import quantile
from rpod_campaign.pmd import sequence as trial
from rpod_campaign.pmd.cells import (
    AXES,
    CALIBRATED_WIGGLING,
    Results,
    calibrated,
    methods,
    scenarios,
    summarise,
)
from rpod_campaign.pmd.sequence import FRAME, SequenceCell
from rpod_campaign.pmd.tables import LOST, by_range, errors_over_range, first, millimetres, overview
from rpod_campaign.pmd.world import World
from rpod_schemas.config.base import check
from rpod_schemas.config.scenario import Scenario
from rpod_schemas.errors import ConfigurationError

_SCENARIO = "tumbling"
_START_M, _LEAVES_M, _END_M = 7.0, 2.1, 1.0
"""Range of the start, where the target begins to leave the image, and of the end."""


@dataclass(frozen=True)
class Case:
    """A world, and the way through it."""

    about: str
    world: World
    range_m: tuple[float, float] = (_START_M, _LEAVES_M)
    """At the start and at the end."""
    pair: str | None = field(default=None)
    """The case with the same frames, undisturbed."""


_1_MM = 1e-3
CASES: Mapping[str, Case] = {
    "nominal": Case("as the estimator assumes", World()),
    "cad-1mm": Case("parts 1 mm off in place and size", World(cad_error_m=_1_MM)),
    "cad-3mm": Case("parts 3 mm off in place and size", World(cad_error_m=3e-3)),
    "depth-lost": Case(
        "1 mm, 60 % of the depth lost in patches",
        World(cad_error_m=_1_MM, depth_lost_share=0.6),
        pair="cad-1mm",
    ),
    "glints": Case(
        "1 mm, glints wipe both images over 40 % of the target",
        World(cad_error_m=_1_MM, glint_share=0.4),
        pair="cad-1mm",
    ),
    "close": Case("1 mm, the target leaves the image", World(cad_error_m=_1_MM), (_LEAVES_M, _END_M)),
}
"""By the names of the command line."""


def cells(options: Options) -> list[SequenceCell]:
    """Return the cells. Raises ConfigurationError, which names the option."""
    names = options.case or tuple(CASES)
    for name in names:
        if name not in CASES:
            raise ConfigurationError("--case", "", f"needs {', '.join(CASES)}, not {name!r}")
    return [
        SequenceCell(
            scenario=scenario_name,
            method=method,
            radius_px=radius_px,
            frames=frames,
            through=through,
            document=approaching(calibrated(scenario), CASES[name].range_m).model_dump_json(),
            target=scenario.target,
            case=name,
            world=CASES[name].world,
        )
        for scenario_name, scenario in scenarios(options, (_SCENARIO,))
        for frames in options.both("frames", "full")
        for through in options.both("through", "tracker")
        for method, radius_px in methods(options, ("joint",))
        for name in names
    ]


def approaching(scenario: Scenario, range_m: tuple[float, float]) -> Scenario:
    """Return a scenario that goes straight from one range to another."""
    document: dict[str, Any] = scenario.model_dump(mode="json")
    start_m, end_m = range_m
    document["motion"]["trajectory"] |= {"start_m": [0.0, 0.0, start_m], "end_m": [0.0, 0.0, end_m]}
    return check(Scenario, document, source=scenario.name)


def sections(results: Results) -> list[Section]:
    """Return the report."""
    close = [result for result in results if result.cell.case == "close"]
    far = [result for result in results if result.cell.case != "close"]
    told = {result.cell.case for result in results}
    about = "; ".join(f"{name}: {case.about}" for name, case in CASES.items() if name in told)
    note = (
        f"{_START_M:g} to {_LEAVES_M:g} m in the sun, what is left of the wiggling {CALIBRATED_WIGGLING:g}, "
        f"close: {_LEAVES_M:g} to {_END_M:g} m. {about}. {LOST}"
    )
    return [
        Section("Worlds", note, overview(results)),
        *_paired_sections(results),
        *([Section("Over the range", "", (by_range(far),), errors_over_range(far))] if far else []),
        *([_close_section(close)] if close else []),
    ]


def _paired_sections(results: Results) -> list[Section]:
    rows = []
    for result in results:
        pair = first(
            results, case=CASES[result.cell.case].pair, method=result.cell.method,
            frames=result.cell.frames, through=result.cell.through, scenario=result.cell.scenario,
        )  # fmt: skip
        if pair is not None:
            rows.append((result.cell.case, pair.cell.case, result.cell.method, *_rises(result, pair)))
    if not rows:
        return []
    columns = ("case", "against", "method", *(axis.split("_")[0] for axis in AXES), "attitude", "position")
    table = Table("Rise of the RMS error, %", columns, tuple(rows))
    return [Section("Paired", "The same frames with and without the disturbance.", (table,))]


def _rises(result: CellResult[SequenceCell], pair: CellResult[SequenceCell]) -> tuple[str, ...]:
    ours, theirs = result.summary, pair.summary
    values = [(ours["rms"][axis], theirs["rms"][axis]) for axis in AXES]
    values += [(ours["norms"][name], theirs["norms"][name]) for name in ("attitude_deg", "position_m")]
    return tuple(number(100.0 * (mine / other - 1.0), "+.1f") for mine, other in values)


def _close_section(results: Results) -> Section:
    """Return error and covariance over the last metre, in bins of a decimetre."""
    rows = []
    for result in results:
        decimetre = (10.0 * pl.col("range_m")).floor().cast(pl.Int64)
        parts = result.rows.with_columns(decimetre.alias("bin")).partition_by("bin")
        rows += [
            (
                result.cell.method,
                f"{part['bin'][0] / 10.0:.1f}",
                *(number(quantile(part["attitude_deg"], share), ".2f") for share in (0.5, 1.0)),
                number(quantile(part["sigma_deg"], 0.5), ".2f"),
                *(number(millimetres(quantile(part["position_m"], share)), ".1f") for share in (0.5, 1.0)),
                number(millimetres(quantile(part["sigma_m"], 0.5)), ".1f"),
            )
            for part in parts
        ]
    columns = (
        *("method", "from, m", "median, deg", "greatest, deg", "median sigma, deg"),
        *("median, mm", "greatest, mm", "median sigma, mm"),
    )
    note = "Sigma is the covariance's in its worst direction: it has to grow where the view does not tell."
    return Section("The last metre", note, (Table("By decimetre", columns, tuple(rows)),))


CAMPAIGN: Campaign[SequenceCell] = Campaign(
    name="pmd-robustness",
    title="Tracking where the mock-up is not as drawn and pixels are lost",
    trials=5,
    accepts=frozenset({"scenario", "method", "radius", "frames", "through", "case"}),
    cells=cells,
    trial=trial.run,
    schema=trial.SCHEMA,
    summarise=summarise,
    sections=sections,
    keys=(FRAME,),
)
