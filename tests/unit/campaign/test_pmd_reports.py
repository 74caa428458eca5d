"""Reports of the camera's campaigns: each cell has a row and a line of its own."""

from dataclasses import fields, replace

import polars as pl
import pytest

from rpod.scenarios import find, shipped
from rpod_campaign.catalogue import find as find_campaign
from rpod_campaign.engine.campaign import CellResult
from rpod_campaign.pmd import sequence
from rpod_campaign.pmd.report.summary import AXES, OTHER_AXES
from rpod_campaign.pmd.sequence import SequenceCell
from rpod_campaign.pmd_acquisition import trial as acquisition
from rpod_campaign.pmd_sun.trial import SunCell

pmd_acquisition = find_campaign("pmd-acquisition")
pmd_robustness = find_campaign("pmd-robustness")
pmd_sun = find_campaign("pmd-sun")
SCENARIOS = {name: find(name) for name in shipped()}
TARGET, OTHER = "mockup", "hexagonal-body"
CELL = SequenceCell("tumbling", "joint", None, "keyframes", "tracker", document="", target=TARGET)


def result(campaign, cell, error=1.0) -> CellResult:
    """Return the result of a cell: one frame with the same error along all axes."""
    row = dict.fromkeys(sequence.SCHEMA) | dict.fromkeys((*AXES, *OTHER_AXES), error)
    row |= {"frame": 0, "range_m": 1.5, "attitude_deg": error, "position_m": error, "track_s": 0.1}
    row |= {"depth_share": 1.0, "measured": True, "off_target": False}
    row |= {"right": True, "believed": True, "ambiguous": False}
    rows = pl.DataFrame([row], schema=sequence.SCHEMA).with_columns(trial=0)
    return CellResult(cell, rows, campaign.summarise(cell, rows))


def test_a_paired_case_has_the_same_radius():
    errors = {("cad-1mm", 10): 1.0, ("cad-1mm", 40): 2.0, ("depth-lost", 10): 2.0, ("depth-lost", 40): 6.0}
    results = [
        result(pmd_robustness, replace(CELL, case=case, radius_px=radius_px), error)
        for (case, radius_px), error in errors.items()
    ]
    paired = next(section for section in pmd_robustness.sections(results) if section.title == "Paired")
    assert paired.tables[0].rows == (
        ("10", "cad-1mm", *["+100.0"] * 8),
        ("40", "cad-1mm", *["+200.0"] * 8),
    )


def test_the_last_metre_is_told_of_each_radius():
    cells = [replace(CELL, case="close", radius_px=radius_px) for radius_px in (10, 40)]
    sections = pmd_robustness.sections([result(pmd_robustness, cell) for cell in cells])
    (table,) = sections[-1].tables
    assert table.columns[0] == "radius, px"
    assert [row[0] for row in table.rows] == ["10", "40"]


def test_suns_are_averaged_over_azimuths_only():
    varied = ({}, {"scenario": "oblique"}, {"frames": "full"}, {"radius_px": 10}, {"radius_px": 40})
    given = {field.name: getattr(CELL, field.name) for field in fields(CELL)} | {"case": "panel"}
    results = [
        result(pmd_sun, SunCell(**given | change, angle_deg=30.0, azimuth_deg=azimuth_deg), error)
        for error, change in enumerate(varied, start=1)
        for azimuth_deg in (0.0, 90.0)
    ]
    over_angle, every = pmd_sun.sections(results)
    (means,) = over_angle.tables
    assert means.columns[:5] == ("scenario", "frames", "radius, px", "angle, deg", "RMS, deg")
    assert [(*row[:3], row[4]) for row in means.rows] == [
        ("tumbling", "keyframes", "-", "1.00"),
        ("oblique", "keyframes", "-", "2.00"),
        ("tumbling", "full", "-", "3.00"),
        ("tumbling", "keyframes", "10", "4.00"),
        ("tumbling", "keyframes", "40", "5.00"),
    ]
    assert len({row[:5] for row in every.tables[0].rows}) == len(results)
    assert len(over_angle.figures[0].data) == len(varied)


@pytest.fixture(scope="module")
def acquired() -> list[CellResult]:
    """Return results in two scenarios with two targets, of another range, and of another model."""
    given = {"scenario": ("tumbling", "oblique"), "target": (TARGET, OTHER), "case": ("all",)}
    cells = pmd_acquisition.cells(pmd_acquisition.options(scenarios=SCENARIOS, **given))
    cells += [replace(cells[0], range_m=(1.0, 2.0)), replace(cells[0], model=f"{TARGET}@scale=1%")]
    row = dict.fromkeys(acquisition.SCHEMA) | {"attitude_deg": 1.0, "success": True, "accepted": False}
    rows = pl.DataFrame([row | {"reason": "cost 1", "verdict": "rejected"}], schema=acquisition.SCHEMA)
    return [CellResult(cell, rows, pmd_acquisition.summarise(cell, rows)) for cell in cells]


def test_every_cell_of_an_acquisition_has_a_name_of_its_own(acquired):
    (section,) = pmd_acquisition.sections(acquired)
    for table in section.tables:
        assert table.columns[:4] == ("scenario", "target", "model", "range, m")
        assert len({row[:4] for row in table.rows}) == len(acquired)
    assert len(section.figures[0].data) == len(acquired)


def test_what_all_cells_of_an_acquisition_share_is_not_in_their_names(acquired):
    (section,) = pmd_acquisition.sections([acquired[0], acquired[4]])
    assert section.tables[0].columns[0] == "range, m"
    names = [trace.name for trace in section.figures[0].data]
    assert names == ["3 to 6 m", "1 to 2 m"]
