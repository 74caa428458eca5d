"""``pmd-sun``: sun from all directions on a mock-up of several materials (the 2018 paper's future work)."""

from collections.abc import Sequence
from typing import Any

import polars as pl

from rpod_campaign.engine.campaign import CellResult
from rpod_campaign.engine.report.charts import curve_figure
from rpod_campaign.engine.report.content import Section, Table
from rpod_campaign.engine.report.numbers import milliseconds, number, percent, word
from rpod_campaign.pmd.report.summary import summarise as summarise_sequence
from rpod_campaign.pmd.report.tables import LOST, label, name_of
from rpod_campaign.pmd_sun.trial import SunCell

Results = Sequence[CellResult[SunCell]]
_NAMES = ("scenario", "material", "frames", "through", "method", "radius, px")
"""Columns of ``name_of``."""


def summarise(cell: SunCell, rows: pl.DataFrame) -> dict[str, Any]:
    """Return the summary of a cell."""
    return summarise_sequence(cell, rows) | {
        "sun_angle_deg": cell.angle_deg,
        "sun_azimuth_deg": cell.azimuth_deg,
    }


def sections(results: Results) -> list[Section]:
    """Return the sections of the report: each sun, then the mean over azimuths."""
    note = (
        "The angle is between the direction to the sun and the boresight. At 0 deg the camera looks into the "
        "sun and sees the mock-up's dark side; at 180 deg the sun is behind the camera. Lens flare is not "
        f"modelled. The azimuth goes from right (0 deg) to down (90 deg). {LOST}"
    )
    return [
        Section("Over the sun's angle", "Means over the azimuths.", (_by_angle(results),), _figures(results)),
        Section("Every sun", note, (_every_sun(results),)),
    ]


def _every_sun(results: Results) -> Table:
    rows = [
        (
            *name_of(r.cell),
            *(word(r.cell.angle_deg), word(r.cell.azimuth_deg)),
            number(r.summary["norms"]["attitude_deg"], ".2f"),
            number(1e3 * r.summary["norms"]["position_m"], ".1f"),
            number(r.summary["max"]["attitude_deg"], ".2f"),
            number(1e3 * r.summary["max"]["position_m"], ".0f"),
            f"{r.summary['lost']} of {r.summary['frames']}",
            percent(1.0 - r.summary["depth_share"]),
            milliseconds(r.summary["median_s"]),
        )
        for r in results
    ]
    columns = (
        *("angle, deg", "azimuth, deg", "RMS, deg", "RMS, mm", "greatest, deg", "greatest, mm"),
        *("lost", "depth lost", "median, ms"),
    )
    return Table("RMS by sun", (*_NAMES, *columns), tuple(rows)).condensed(len(_NAMES))


def _grouped(results: Results) -> pl.DataFrame:
    """Return means over azimuths, a row for each angle of each sequence."""
    cells = [result.cell for result in results]
    rows = pl.DataFrame(
        [
            {
                **dict(zip(_NAMES, name_of(r.cell), strict=True)),
                "line": label(r.cell, cells),
                "angle": r.cell.angle_deg,
                "attitude": r.summary["norms"]["attitude_deg"],
                "position": r.summary["norms"]["position_m"],
                "lost": r.summary["lost"] / r.summary["frames"],
                "depth_lost": 1.0 - r.summary["depth_share"],
            }
            for r in results
        ]
    )
    return rows.group_by(*_NAMES, "line", "angle", maintain_order=True).mean()


def _by_angle(results: Results) -> Table:
    rows = [
        (
            *(row[name] for name in _NAMES),
            word(row["angle"]),
            number(row["attitude"], ".2f"),
            number(1e3 * row["position"], ".1f"),
            percent(row["lost"]),
            percent(row["depth_lost"]),
        )
        for row in _grouped(results).iter_rows(named=True)
    ]
    columns = ("angle, deg", "RMS, deg", "RMS, mm", "lost", "depth lost")
    return Table("Means over the azimuths", (*_NAMES, *columns), tuple(rows)).condensed(len(_NAMES))


def _figures(results: Results) -> tuple[Any, ...]:
    groups = {str(name): part for (name,), part in _grouped(results).group_by("line", maintain_order=True)}
    return tuple(
        curve_figure(
            {name: (part["angle"].to_list(), part[column].to_list()) for name, part in groups.items()},
            x_title="sun from the boresight [deg]",
            y_title=title,
            log_y=log,
        )
        for column, title, log in (
            ("attitude", "RMS attitude error [deg]", True),
            ("depth_lost", "share of depth lost", False),
        )
    )
