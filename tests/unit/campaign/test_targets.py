"""``--target`` and ``--ranges`` with a target of a file: ranges and limits follow from its size."""

import numpy as np
import polars as pl
import pytest
import yaml
from pydantic import ValidationError

from rpod.scenarios import find, shipped
from rpod_campaign.catalogue import BUILT_IN
from rpod_campaign.catalogue import find as find_campaign
from rpod_campaign.engine.campaign import CellResult
from rpod_campaign.engine.trial.sizes import in_metres
from rpod_campaign.engine.trial.targets import cached_target
from rpod_campaign.lidar import scores
from rpod_campaign.lidar.cells import ranges_m
from rpod_campaign.lidar.methods import lidar_config
from rpod_campaign.lidar.returns import COMMON_RETURNS, ELLIPSE_RETURNS, ellipse_m, range_of_returns
from rpod_campaign.lidar.scene import emulator_of, random_pose, scan_of
from rpod_campaign.lidar_acquisition.options import Options as LidarOptions
from rpod_campaign.lidar_tracking import trial as lidar_tracking
from rpod_campaign.lidar_trajectory import trial as lidar_trajectory
from rpod_campaign.pmd import poses
from rpod_campaign.pmd.framing import FILLED, range_filling
from rpod_campaign.pmd.scene import camera_of, scenario_of
from rpod_campaign.pmd_acquisition import trial as pmd_acquisition
from rpod_schemas.errors import ConfigurationError

SCENARIOS = {name: find(name) for name in shipped()}
SIZE_M = 0.8
COUNTED = {"success_rate", "trials", "wrong_accepted", "ambiguous"}
"""Keys that each cell of a campaign of first poses or of tracking has, also for a target of a file."""
GREY = {"reflectivity": 0.5, "diffuse": 0.4, "f0": 0.02, "roughness": 0.3}


@pytest.fixture(scope="module")
def brick(tmp_path_factory):
    """Return the file of a box with a fin, 0.8 m long."""
    document = {
        "name": "brick",
        "mass_kg": 20.0,
        "materials": {"grey": GREY},
        "parts": [
            {"name": "block", "shape": "box", "size_m": [SIZE_M, 0.5, 0.3], "material": "grey"},
            {
                "name": "fin",
                "shape": "box",
                "size_m": [0.2, 0.05, 0.4],
                "material": "grey",
                "T_target_part": {"translation_m": [0.2, 0.1, 0.3]},
            },
        ],
        "distance_field": {"spacing_m": 0.02, "margin_m": 0.2},
    }
    file = tmp_path_factory.mktemp("brick") / "brick.yaml"
    file.write_text(yaml.safe_dump(document))
    return str(file)


def cells(name, **options):
    campaign = find_campaign(name)
    provided = {"scenarios": SCENARIOS} if "scenarios" in campaign.options.model_fields else {}
    return list(campaign.cells(campaign.options(**provided, **options)))


def test_a_range_is_in_metres_or_in_longest_sides(brick):
    options = LidarOptions(ranges=("20", "2.5x"), target=(brick,))
    assert options.ranges == (20.0, "2.5x")
    assert in_metres(options.ranges, cached_target(brick)) == (20.0, pytest.approx(2.0))
    assert [cell.range_m for cell in cells("lidar-acquisition", target=(brick,), ranges=("2.5x",))] == (
        pytest.approx([2.0] * 3)
    )
    assert LidarOptions(ranges=(".5x", "0.05x", "10x")).ranges == (".5x", "0.05x", "10x")


@pytest.mark.parametrize("nothing", ["0x", "0.0x", ".0x", "x"])
def test_a_range_of_no_longest_sides_is_refused(nothing):
    with pytest.raises(ValidationError, match="pattern"):
        LidarOptions(ranges=(nothing,))


def test_the_ranges_of_a_shipped_target_are_the_default_and_those_of_another_follow_from_its_returns(brick):
    assert ranges_m(LidarOptions(), "envisat-bulky") == (20.0, 30.0, 40.0, 50.0)
    found_m = ranges_m(LidarOptions(target=(brick,)), brick)
    assert list(found_m) == sorted(found_m)
    assert found_m[-1] == range_of_returns(brick, COMMON_RETURNS[-1])
    emulator = emulator_of(brick, lidar_config(), 7)
    counts = []
    for trial in range(30):
        pose = random_pose(brick, range_m=found_m[-1], sampling="so3", seed=7, trial=trial).T_sensor_target
        counts.append(len(scan_of(emulator, pose, trial=trial).returns_m))
    assert np.mean(counts) == pytest.approx(COMMON_RETURNS[-1], rel=0.25)


def test_limits_are_absolute_for_a_shipped_target_and_relative_for_another(brick):
    mockup, other = cached_target("mockup"), cached_target(brick)
    assert scores.limits_of(mockup).position_m == 0.3
    assert scores.limits_of(other).position_m == pytest.approx(0.03 * SIZE_M)
    assert poses.limits_of(mockup).position_m == 0.08
    assert poses.limits_of(other).position_m == pytest.approx(0.04 * SIZE_M)
    assert poses.in_proportion(0.03, mockup) == 0.03
    assert poses.in_proportion(0.03, other) == pytest.approx(0.02)
    assert lidar_tracking.off_m(mockup) == 0.3
    assert lidar_tracking.off_m(other) == pytest.approx(0.03 * SIZE_M)


def test_the_position_decides_on_success_for_a_target_of_a_file_only(brick):
    assert scores.is_success(1.0, 0.2, cached_target("mockup"))
    assert not scores.is_success(1.0, 0.2, cached_target(brick))
    assert scores.is_success(1.0, 0.01, cached_target(brick))
    assert not scores.is_success(None, None, cached_target(brick))


def test_the_ellipse_of_another_target_begins_where_enough_returns_come(brick):
    assert ellipse_m("envisat-bulky") == (25.0, 53.0)
    least_m, greatest_m = ellipse_m(brick)
    assert least_m == range_of_returns(brick, ELLIPSE_RETURNS)
    assert greatest_m > 2.0 * least_m
    ranges_m = [
        np.linalg.norm(lidar_trajectory.motion_of(brick).state(50.0 * k).T_chaser_target.translation)
        for k in range(0, lidar_trajectory.POSITIONS, 10)
    ]
    assert [min(ranges_m), max(ranges_m)] == pytest.approx([least_m, greatest_m], rel=0.1)


def test_the_positions_on_the_ellipse_are_those_of_the_paper():
    motion = lidar_trajectory.motion_of("envisat-bulky")
    centre_of_mass_m = cached_target("envisat-bulky").centre_of_mass_m
    times_s = lidar_trajectory.INTERVAL_S * np.arange(lidar_trajectory.POSITIONS)
    assert (times_s[1], times_s[-1]) == (50.0, 12000.0)
    centres_m = np.array([motion.state(time_s).T_chaser_target.apply(centre_of_mass_m) for time_s in times_s])
    np.testing.assert_allclose(centres_m[:, :2], 0.0, atol=1e-9)
    assert [centres_m[:, 2].min(), centres_m[:, 2].max()] == pytest.approx([25.0, 53.0], abs=0.05)


def test_answers_that_name_rivals_are_counted_except_by_symmetry():
    columns = {"verdict": pl.String, "accepted": pl.Boolean, "right_hypothesis": pl.Boolean}
    rows = [("ambiguous", False, True), ("ambiguous", False, False), ("ambiguous", True, True)]
    frame = pl.DataFrame([*rows, ("accepted", True, True)], schema=columns, orient="row")
    assert scores.ambiguous(frame) == {"ambiguous": 2, "ambiguous_with_truth": 1}


def test_a_camera_scenario_keeps_its_own_target_and_its_own_approach():
    (plain,) = cells("pmd-tracking", scenario=("oblique",), method=("joint",))
    (named,) = cells("pmd-tracking", scenario=("oblique",), method=("joint",), target=("mockup",))
    assert plain == named
    assert plain.document == SCENARIOS["mockup-oblique"].model_dump_json()


def test_another_target_approaches_from_where_it_fills_little_to_where_it_fills_much(brick):
    (cell,) = cells("pmd-tracking", scenario=("oblique",), method=("joint",), target=(brick,))
    scenario = scenario_of(cell.document)
    assert (cell.scenario, cell.target, scenario.target) == ("oblique with brick", brick, brick)
    camera, target = camera_of(scenario), cached_target(brick)
    way = scenario.motion.trajectory
    expected_m = [range_filling(target, filled, camera) for filled in FILLED]
    assert [way.start_m[2], way.end_m[2]] == pytest.approx(expected_m)
    assert scenario.estimator.initial_pose is None
    (nearer,) = cells(
        "pmd-tracking", scenario=("oblique",), method=("joint",), target=(brick,), ranges=("2", "5x")
    )
    way = scenario_of(nearer.document).motion.trajectory
    assert [way.start_m[2], way.end_m[2]] == pytest.approx([4.0, 2.0])
    with pytest.raises(ConfigurationError, match="--ranges: is 2 m alone; it needs two ranges"):
        cells("pmd-tracking", scenario=("oblique",), method=("joint",), target=(brick,), ranges=("2",))


def test_the_ranges_of_an_acquisition_are_chosen_or_follow_from_the_image(brick):
    camera, target = camera_of(SCENARIOS["mockup-tumbling"]), cached_target(brick)
    filling_m = tuple(range_filling(target, filled, camera) for filled in FILLED[::-1])
    asked = {"case": ("all",), "target": (brick,)}
    assert cells("pmd-acquisition", **asked)[0].range_m == pytest.approx(filling_m)
    assert cells("pmd-acquisition", ranges=("5x", "2"), **asked)[0].range_m == pytest.approx((2.0, 4.0))
    assert cells("pmd-acquisition", case=("all",))[0].range_m == (3.0, 6.0)


def test_a_coat_that_a_target_lacks_is_left_out(brick):
    coats = {cell.case for cell in cells("pmd-sun", target=(brick,))}
    assert coats == {"as-built"}
    cases = {cell.case for cell in cells("pmd-acceptance", target=(brick,))}
    assert "right" in cases
    assert not any(case.startswith("all-") for case in cases)


def test_a_frame_of_another_target_is_scored_by_its_size(brick):
    (cell,) = cells("pmd-acquisition", case=("all",), target=(brick,), ranges=("3x",))
    row = pmd_acquisition.run(cell, 3, 1)
    assert row["success"] == (
        row["attitude_deg"] is not None and row["attitude_deg"] < 4.0 and row["position_m"] < 0.04 * SIZE_M
    )
    campaign = find_campaign("pmd-acquisition")
    assert set(campaign.summarise(cell, pl.DataFrame([row], schema=campaign.schema))) >= COUNTED


@pytest.mark.parametrize("name", [name for name in BUILT_IN if name.startswith(("lidar-", "template"))])
def test_every_lidar_campaign_has_cells_for_a_target_of_a_file(name, brick):
    found = cells(name, target=(brick,))
    assert {cell.target for cell in found} == {brick}


@pytest.mark.parametrize(
    "name", ["pmd-tracking", "pmd-sun", "pmd-robustness", "pmd-acquisition", "pmd-acceptance"]
)
def test_every_camera_campaign_has_cells_for_a_target_of_a_file(name, brick):
    found = cells(name, target=(brick,))
    assert {scenario_of(cell.document).target for cell in found} == {brick}


def test_a_tracked_scan_of_another_target_is_counted(brick):
    (cell, *_) = cells("lidar-tracking", target=(brick,), matcher=("projective",))
    campaign = find_campaign("lidar-tracking")
    frame = pl.DataFrame([campaign.trial(cell, 7, trial) for trial in range(2)], schema=campaign.schema)
    summary = campaign.summarise(cell, frame)
    assert set(summary) >= COUNTED
    campaign.sections([CellResult(cell, frame, summary)])
