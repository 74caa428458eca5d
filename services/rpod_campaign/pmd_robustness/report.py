"""``pmd-robustness``: a mock-up that differs from its model, lost depth, glints, and the last metre."""

import polars as pl

from rpod_campaign.engine.campaign import CellResult
from rpod_campaign.engine.report.content import Section, Table
from rpod_campaign.engine.report.numbers import millimetres, number
from rpod_campaign.engine.report.statistics import quantile
from rpod_campaign.pmd.cells import CALIBRATED_WIGGLING
from rpod_campaign.pmd.report.summary import AXES, Results
from rpod_campaign.pmd.report.tables import LOST, NAMES, by_range, errors_over_range, first, name_of, overview
from rpod_campaign.pmd.sequence import SequenceCell
from rpod_campaign.pmd_robustness.trial import CASES, END_M, LEAVES_M, START_M


def sections(results: Results) -> list[Section]:
    """Return the sections of the report."""
    close = [result for result in results if result.cell.case == "close"]
    far = [result for result in results if result.cell.case != "close"]
    told = {result.cell.case for result in results}
    about = "; ".join(f"{name}: {case.about}" for name, case in CASES.items() if name in told)
    note = (
        f"Range {START_M:g} to {LEAVES_M:g} m in the sun, remaining wiggling {CALIBRATED_WIGGLING:g}; "
        f"close: {LEAVES_M:g} to {END_M:g} m. {about}. {LOST}"
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
            radius_px=result.cell.radius_px,
        )  # fmt: skip
        if pair is not None:
            rows.append((*name_of(result.cell), pair.cell.case, *_rises(result, pair)))
    if not rows:
        return []
    columns = (*NAMES, "against", *(axis.split("_")[0] for axis in AXES), "attitude", "position")
    table = Table("Rise of the RMS error, %", columns, tuple(rows)).condensed(len(NAMES))
    return [Section("Paired", "The same frames with and without the disturbance.", (table,))]


def _rises(result: CellResult[SequenceCell], pair: CellResult[SequenceCell]) -> tuple[str, ...]:
    ours, theirs = result.summary, pair.summary
    values = [(ours["rms"][axis], theirs["rms"][axis]) for axis in AXES]
    values += [(ours["norms"][name], theirs["norms"][name]) for name in ("attitude_deg", "position_m")]
    return tuple(number(100.0 * (mine / other - 1.0), "+.1f") for mine, other in values)


def _close_section(results: Results) -> Section:
    """Return error and covariance over the last metre, in bins of 0.1 m."""
    rows = []
    for result in results:
        decimetre = (10.0 * pl.col("range_m")).floor().cast(pl.Int64)
        parts = result.rows.with_columns(decimetre.alias("bin")).partition_by("bin")
        rows += [
            (
                *name_of(result.cell),
                f"{part['bin'][0] / 10.0:.1f}",
                *(number(quantile(part["attitude_deg"], share), ".2f") for share in (0.5, 1.0)),
                number(quantile(part["sigma_deg"], 0.5), ".2f"),
                *(millimetres(quantile(part["position_m"], share)) for share in (0.5, 1.0)),
                millimetres(quantile(part["sigma_m"], 0.5)),
            )
            for part in parts
        ]
    columns = (
        *(*NAMES, "from, m", "median, deg", "greatest, deg", "median sigma, deg"),
        *("median, mm", "greatest, mm", "median sigma, mm"),
    )
    table = Table("By decimetre", columns, tuple(rows)).condensed(len(NAMES))
    note = "Sigma is that of the covariance in its worst direction; it must grow if the view is ambiguous."
    return Section("The last metre", note, (table,))
