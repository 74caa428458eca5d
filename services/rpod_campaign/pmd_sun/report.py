"""``pmd-sun``: suns from all sides on a mock-up of all materials (the 2018 paper's future work)."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
import polars as pl

from rpod_campaign.engine.campaign import Campaign, CellResult, Options, Section, Table
from rpod_campaign.engine.charts import curve_figure
from rpod_campaign.engine.numbers import milliseconds, number, percent, word
from rpod_campaign.papers import paper_2018 as paper
from rpod_campaign.pmd import sequence as trial
from rpod_campaign.pmd.cells import methods, scenarios
from rpod_campaign.pmd.cells import summarise as summarise_sequence
from rpod_campaign.pmd.sequence import FRAME, SequenceCell
from rpod_campaign.pmd.tables import LOST
from rpod_campaign.pmd.world import World
from rpod_schemas.config.base import check
from rpod_schemas.config.scenario import Scenario
from rpod_schemas.errors import ConfigurationError

AS_BUILT = "as-built"
COATS = (AS_BUILT, "panel", "gold-mli", "silver-mli")
_ANGLES_DEG = (0.0, 30.0, 60.0, 90.0, 120.0, 150.0, 180.0)
_AZIMUTHS_DEG = (0.0, 90.0, 180.0, 270.0)


@dataclass(frozen=True)
class SunCell(SequenceCell):
    """A sequence under a sun; ``case`` is what covers the mock-up."""

    angle_deg: float = 0.0
    """Between the directions to the sun and of the boresight: at 0 the camera looks into the sun."""
    azimuth_deg: float = 0.0
    """About the boresight, from x (right) to y (down)."""


Results = Sequence[CellResult[SunCell]]


def cells(options: Options) -> list[SunCell]:
    """Return the cells. Raises ConfigurationError, which names the option."""
    coats = options.case or COATS
    for coat in coats:
        if coat not in COATS:
            raise ConfigurationError("--case", "", f"needs {', '.join(COATS)}, not {coat!r}")
    return [
        SunCell(
            scenario=name,
            method=method,
            radius_px=radius_px,
            frames=frames,
            through="tracker",
            document=lit(scenario, angle_deg, azimuth_deg).model_dump_json(),
            target=scenario.target,
            case=coat,
            world=World(coat=None if coat == AS_BUILT else coat),
            angle_deg=angle_deg,
            azimuth_deg=azimuth_deg,
        )
        for name, scenario in scenarios(options, (paper.TUMBLING,))
        for frames in options.both("frames", "keyframes")
        for method, radius_px in methods(options, ("hybrid", "joint"))
        for coat in coats
        for angle_deg, azimuth_deg in product(_ANGLES_DEG, _AZIMUTHS_DEG)
        if azimuth_deg == 0.0 or 0.0 < angle_deg < 180.0  # where the azimuth says nothing, once
    ]


def lit(scenario: Scenario, angle_deg: float, azimuth_deg: float) -> Scenario:
    """Return a scenario with the sun elsewhere, as seen at the epoch."""
    angle, azimuth = np.deg2rad((angle_deg, azimuth_deg))
    across = np.sin(angle)
    direction = [across * np.cos(azimuth), across * np.sin(azimuth), np.cos(angle)]
    document: dict[str, Any] = scenario.model_dump(mode="json")
    document["motion"]["sun"] = (document["motion"]["sun"] or {}) | {"direction": direction}
    return check(Scenario, document, source=scenario.name)


def summarise(cell: SunCell, rows: pl.DataFrame) -> dict[str, Any]:
    """Return what is said of a cell."""
    return summarise_sequence(cell, rows) | {
        "sun_angle_deg": cell.angle_deg,
        "sun_azimuth_deg": cell.azimuth_deg,
    }


def sections(results: Results) -> list[Section]:
    """Return the report: each sun, then the mean over azimuths."""
    note = (
        "The angle is between the direction to the sun and the boresight: at 0 deg the camera looks into the "
        "sun and the mock-up shows its dark side, at 180 deg the sun stands behind the camera; the camera's "
        f"own lens flare is not modelled. The azimuth goes from right (0 deg) to down (90 deg). {LOST}"
    )
    return [
        Section("Over the sun's angle", "Means over the azimuths.", (_by_angle(results),), _figures(results)),
        Section("Every sun", note, (_every_sun(results),)),
    ]


def _every_sun(results: Results) -> Table:
    rows = [
        (
            *(r.cell.scenario, r.cell.frames, r.cell.method, r.cell.case),
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
    names = ("scenario", "frames", "method", "material", "angle, deg", "azimuth, deg")
    columns = ("RMS, deg", "RMS, mm", "greatest, deg", "greatest, mm", "lost", "depth lost", "median, ms")
    return Table("RMS by sun", (*names, *columns), tuple(rows)).condensed(4)


_GROUP = ("method", "case")


def _grouped(results: Results) -> pl.DataFrame:
    """Return means over azimuths, a row for each method, material and angle."""
    rows = pl.DataFrame(
        [
            {
                "method": r.cell.method,
                "case": r.cell.case,
                "angle": r.cell.angle_deg,
                "attitude": r.summary["norms"]["attitude_deg"],
                "position": r.summary["norms"]["position_m"],
                "lost": r.summary["lost"] / r.summary["frames"],
                "depth_lost": 1.0 - r.summary["depth_share"],
            }
            for r in results
        ]
    )
    return rows.group_by(*_GROUP, "angle", maintain_order=True).mean()


def _by_angle(results: Results) -> Table:
    rows = [
        (
            *(row["method"], row["case"], word(row["angle"])),
            number(row["attitude"], ".2f"),
            number(1e3 * row["position"], ".1f"),
            percent(row["lost"]),
            percent(row["depth_lost"]),
        )
        for row in _grouped(results).iter_rows(named=True)
    ]
    columns = ("method", "material", "angle, deg", "RMS, deg", "RMS, mm", "lost", "depth lost")
    return Table("Means over the azimuths", columns, tuple(rows)).condensed(2)


def _figures(results: Results) -> tuple[Any, ...]:
    groups = {
        ", ".join(map(str, key)): part
        for key, part in _grouped(results).group_by(*_GROUP, maintain_order=True)
    }
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


CAMPAIGN: Campaign[SunCell] = Campaign(
    name="pmd-sun",
    title="Tracking under every sun, on every material",
    trials=1,
    accepts=frozenset({"scenario", "method", "radius", "frames", "case"}),
    cells=cells,
    trial=trial.run,
    schema=trial.SCHEMA,
    summarise=summarise,
    sections=sections,
    keys=(FRAME,),
)
