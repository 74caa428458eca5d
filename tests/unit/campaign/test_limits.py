"""Limits that follow from right and wrong poses of a population."""

import json

import polars as pl
import pytest

from rpod.campaign.command import campaign_command
from rpod_campaign.engine.campaign import CellResult
from rpod_campaign.limits.campaign import CAMPAIGN
from rpod_campaign.limits.derivation import derived, refused
from rpod_campaign.limits.options import Options
from rpod_campaign.limits.report import sections, summarise, totals
from rpod_campaign.limits.trial import EVIDENCE, NEAR, OTHER, SCHEMA, SEARCHED, START, input_of
from rpod_schemas.config.tuning import Limit, LimitField, limits_in
from rpod_sim_sensor.worlds import WORLDS

MOST = LimitField("most", 6, Limit("inconsistent_pixels_in_patch"), None)
LEAST = LimitField("least", 0.47, Limit("edges_in_place_share", least=True), None)
WARNS = LimitField("warns", 0.58, Limit("edges_in_place_share", least=True, usual=0.9), None)


def poses(count: int = 1, *, start: str = NEAR, right: bool = True, seen: bool = True, **evidence: float):
    row = dict.fromkeys(SCHEMA) | {START: start, "seen": seen, "right": right} | evidence
    return pl.DataFrame([row] * count, schema=SCHEMA)


def test_a_limit_is_what_the_share_of_right_poses_meets_and_a_margin():
    shares = [poses(edges_in_place_share=0.5 + k / 200.0) for k in range(101)]
    pixels = [poses(inconsistent_pixels_in_patch=float(k)) for k in range(11)]
    least = derived(LEAST, [pl.concat(shares)], quantile=0.98, margin=0.1)
    assert least.value == pytest.approx(0.45)  # 0.51 less a tenth, rounded so that more poses pass
    assert derived(WARNS, [pl.concat(shares)], quantile=0.98, margin=0.1).value == pytest.approx(0.54)
    assert derived(MOST, [pl.concat(pixels)], quantile=0.98, margin=0.15).value == 12
    assert (least.right, least.bodies) == (101, 1)


def test_limits_are_derived_in_the_worlds_that_are_for_design():
    assert set(Options().world) == {name for name, world in WORLDS.items() if not world.held_out}


def test_only_right_poses_that_the_tracker_reached_without_help_in_frames_that_count_give_a_limit():
    rows = pl.concat(
        [
            poses(5, inconsistent_pixels_in_patch=2.0),
            poses(5, start=SEARCHED, inconsistent_pixels_in_patch=3.0),
            poses(start="half turn about x", inconsistent_pixels_in_patch=20.0),
            poses(right=False, inconsistent_pixels_in_patch=20.0),
            poses(seen=False, inconsistent_pixels_in_patch=20.0),
        ]
    )
    found = derived(MOST, [rows], quantile=0.99, margin=0.0)
    assert (found.value, found.right) == (3, 10)
    assert refused(rows, MOST, found.value).sum() == 3


def test_the_interval_is_over_satellites_and_without_evidence_today_s_limit_stays():
    alike = [poses(50, edges_in_place_share=0.8)] * 8
    one = [*alike[1:], poses(50, edges_in_place_share=0.6)]
    assert derived(LEAST, alike, quantile=0.99, margin=0.0).low == pytest.approx(0.8)
    spread = derived(LEAST, one, quantile=0.99, margin=0.0)
    assert (spread.low, spread.value) == (pytest.approx(0.6), pytest.approx(0.6))
    assert spread.high == pytest.approx(0.8)  # a third of the choices lacks the one satellite
    assert derived(LEAST, [poses()], quantile=0.99, margin=0.0).value == 0.47


@pytest.mark.parametrize("sensor", ["lidar", "pmd"])
def test_totals_tell_what_each_limit_refuses_of_right_and_wrong_poses(sensor):
    (cell,) = CAMPAIGN.cells(Options(target=("hexagonal-body",), sensor="lidar", world=("documented",)))
    fields = limits_in(input_of(sensor).tracking)
    good = {each.limit.evidence: 1.0 if each.limit.least else 0.0 for each in fields}
    bad = good | {fields[0].limit.evidence: 0.5}
    rows = pl.concat(
        [poses(9, **good), poses(3, right=False, start=OTHER, **bad), poses(right=False, **good)]
    ).with_columns(pl.lit(0).alias("trial"))
    cell = cell.__class__(**{**cell.__dict__, "sensor": sensor})
    results = [CellResult(cell, rows, summarise(cell, rows))]
    told = totals(results)
    first = told["limits"][fields[0].path]
    assert first["derived"] == 0.0
    assert (first["wrong_refused"]["count"], first["wrong_refused_alone"]["count"]) == (3, 3)
    assert told["together"]["derived"]["wrong_refused"]["count"] == 3
    assert told["together"]["derived"]["right_refused"]["count"] == 0
    for section in sections(results):
        for table in section.tables:
            assert all(len(row) == len(table.columns) for row in table.rows)


def test_the_command_judges_right_and_wrong_poses_of_one_scan(tmp_path, capsys):
    options = {"target": "hexagonal-body,mockup", "trials": "1", "returns": "200,300", "world": "noisy"}
    assert campaign_command("limits", options=options, jobs=1, out=tmp_path, as_json=True) == 0
    printed = json.loads(capsys.readouterr().out)
    assert [cell["frames"] for cell in printed["cells"]] == [1, 1]
    assert all(cell["right"] > 0 and cell["wrong"] > 0 for cell in printed["cells"])
    assert set(printed["totals"]["limits"]) == {each.path for each in limits_in(input_of("lidar").tracking)}
    assert {each["evidence"] for each in printed["totals"]["limits"].values()} < set(EVIDENCE)
