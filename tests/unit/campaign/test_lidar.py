import json
from itertools import pairwise

import numpy as np
import polars as pl
import pytest
from scipy.spatial.transform import Rotation

from rpod_campaign.catalogue import find as find_campaign
from rpod_campaign.engine.campaign import CellResult
from rpod_campaign.engine.trial.poses import errors
from rpod_campaign.engine.trial.streams import stream
from rpod_campaign.engine.trial.targets import cached_target
from rpod_campaign.lidar.methods import lidar_config
from rpod_campaign.lidar.scene import clearance_m, emulator_of, random_attitude, random_pose, scan_of
from rpod_campaign.lidar_acceptance import trial as acceptance
from rpod_campaign.lidar_acceptance.report import roc
from rpod_campaign.lidar_acceptance.trial import AcceptanceCell
from rpod_campaign.lidar_acquisition import trial as acquisition
from rpod_campaign.lidar_range.trial import window_deg
from rpod_campaign.lidar_tracking import trial as tracking
from rpod_campaign.lidar_trajectory import trial as trajectory
from rpod_campaign.lidar_trajectory.figures import figures_over_steps
from rpod_campaign.papers import paper_2015 as paper
from rpod_schemas.errors import ConfigurationError
from rpod_schemas.poses import make_pose

lidar_acquisition = find_campaign("lidar-acquisition")
lidar_trajectory = find_campaign("lidar-trajectory")
TARGET = "envisat-bulky"


def test_a_drawn_pose_depends_on_seed_and_trial_alone():
    def draw(seed=7, trial=3, range_m=50.0):
        pose = random_pose(TARGET, range_m=range_m, sampling="euler", seed=seed, trial=trial)
        return pose.T_sensor_target.rotation.as_quat().tolist()

    assert draw() == draw() == draw(range_m=40.0)
    assert draw() != draw(trial=4)
    assert draw() != draw(seed=8)


def test_no_part_of_the_target_is_near_the_sensor_and_what_was_discarded_is_counted():
    drawn = [random_pose(TARGET, range_m=20.0, sampling="so3", seed=1, trial=trial) for trial in range(600)]
    assert min(clearance_m(TARGET, pose.T_sensor_target) for pose in drawn) >= 2.0
    assert 0 < sum(pose.discarded for pose in drawn) < 100


def test_the_clearance_is_the_distance_to_the_nearest_corner_edge_or_face():
    pose = random_pose(TARGET, range_m=30.0, sampling="so3", seed=1, trial=5).T_sensor_target
    corners_m = pose.apply(cached_target(TARGET).triangles_m.reshape(-1, 3))
    nearest_corner_m = float(np.linalg.norm(corners_m, axis=1).min())
    assert 0.8 * nearest_corner_m < clearance_m(TARGET, pose) <= nearest_corner_m


def test_euler_uniform_attitudes_favour_the_poles_of_the_pitch_and_uniform_ones_do_not():
    generator = stream(3, 0)
    steep = {}
    for sampling in ("euler", "so3"):
        attitudes = [random_attitude(sampling, generator) for _ in range(2000)]
        pitch_deg = [attitude.as_euler("ZYX", degrees=True)[1] for attitude in attitudes]
        steep[sampling] = float(np.mean(np.abs(pitch_deg) > 60.0))
    assert steep["euler"] == pytest.approx(1 / 3, abs=0.04)
    assert steep["so3"] == pytest.approx(1 - np.sin(np.radians(60.0)), abs=0.03)


@pytest.fixture(scope="module")
def acquired():
    """Return a cell of coarse template matching and three of its rows."""
    options = lidar_acquisition.options(method=(paper.TM,), ranges=(20.0,), steps=(60.0,))
    (cell,) = lidar_acquisition.cells(options)
    return cell, [acquisition.run(cell, 7, trial) for trial in range(3)]


def test_a_trial_of_acquisition_fills_every_column(acquired):
    _, rows = acquired
    for row in rows:
        assert set(row) == set(acquisition.SCHEMA)
        assert row["templates"] == 196
        assert row["returns"] > 100
        assert row["acquire_s"] > 0.0
        assert row["icp_s"] > 0.0
        # the paper's position is the centroid of the cloud, metres off before ICP
        assert row["template_position_error_m"] > 0.3


def test_a_trial_is_the_same_whoever_runs_it(acquired):
    cell, rows = acquired
    clocks = {"acquire_s", "icp_s"}
    again = acquisition.run(cell, 7, 1)
    assert {k: v for k, v in again.items() if k not in clocks} == {
        k: v for k, v in rows[1].items() if k not in clocks
    }


def test_the_summary_counts_wrong_poses_that_were_accepted_and_right_ones_that_were_not(acquired):
    cell, rows = acquired
    changes = (
        {"success": True, "accepted": False, "attitude_error_deg": 0.1, "position_error_m": 0.01},
        {"success": False, "accepted": True, "attitude_error_deg": 90.0, "position_error_m": 0.01},
        {"success": True, "accepted": True, "attitude_error_deg": 0.1, "position_error_m": 0.5},
    )
    frame = pl.DataFrame(
        [row | change for row, change in zip(rows, changes, strict=True)], schema=acquisition.SCHEMA
    )
    summary = lidar_acquisition.summarise(cell, frame)
    assert summary["success_rate"] == pytest.approx(2 / 3)
    assert (summary["wrong_accepted"], summary["right_rejected"]) == (2, 1)
    assert summary["wilson_low"] < summary["success_rate"] < summary["wilson_high"]


def test_the_trajectory_is_that_of_the_paper():
    motion = trajectory.motion_of(TARGET)
    centre_m = cached_target(TARGET).centre_of_mass_m
    poses = [motion.state(50.0 * n).T_chaser_target for n in range(trajectory.POSITIONS)]
    ranges_m = np.linalg.norm([pose.apply(centre_m) for pose in poses], axis=1)
    assert ranges_m.min() == pytest.approx(25.0, abs=0.1)
    assert ranges_m.max() == pytest.approx(53.0, abs=0.1)
    turns_deg = [np.rad2deg((a.rotation.inv() * b.rotation).magnitude()) for a, b in pairwise(poses)]
    assert min(turns_deg) > 10.0


def test_a_trial_of_the_trajectory_refines_one_template_by_both_ways_to_pair_points():
    options = lidar_trajectory.options(
        steps=(60.0,), target=(TARGET,), eq4="printed", method=(paper.TM, paper.FAST_TM)
    )
    results = []
    for cell in lidar_trajectory.cells(options):
        rows = [trajectory.run(cell, 7, position) for position in (0, 120)]
        for row in rows:
            assert set(row) == set(trajectory.SCHEMA)
            assert len(row["nn_found"]) == len(row["ns_found"]) == 7
            assert max(row["euler_wrapped_deg"]) <= 180.0
            assert row["template_attitude_error_deg"] <= 180.0
        frame = pl.DataFrame(rows, schema=trajectory.SCHEMA)
        results.append(CellResult(cell, frame, lidar_trajectory.summarise(cell, frame)))
    _check_sections(lidar_trajectory.sections(results))


def test_tables_hold_the_papers_numbers_beside_ours(acquired):
    cell, rows = acquired
    frame = pl.DataFrame(rows, schema=acquisition.SCHEMA)
    result = CellResult(cell, frame, lidar_acquisition.summarise(cell, frame))
    success = lidar_acquisition.sections([result])[0].tables[0]
    assert success.rows[0][success.columns.index("paper")] == "0.65"


def _check_sections(sections):
    for section in sections:
        for table in section.tables:
            assert all(len(row) == len(table.columns) for row in table.rows), table.title


def test_what_the_paper_prints_twice_agrees():
    shares = {step: count / paper.TRAJECTORY_POSITIONS for step, count in paper.TRAJECTORY_SUCCESSES.items()}
    assert shares[10.0] == pytest.approx(0.76, abs=0.005)
    assert shares[60.0] == pytest.approx(0.59, abs=0.005)
    assert shares[30.0] == pytest.approx(0.72, abs=0.005)
    assert set(paper.COSTS) == {(m, s) for m in (paper.TM, paper.FAST_TM) for s in shares}


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"method": ("magic",)}, "--method: needs template-matching"),
        ({"target": ("hubble",)}, "--target: .*hubble"),
        ({"matcher": ("thumb",)}, "--matcher: needs nearest-neighbour"),
    ],
)
def test_what_is_not_known_is_refused_by_the_name_of_its_option(options, reason):
    with pytest.raises(ConfigurationError, match=reason):
        lidar_acquisition.cells(lidar_acquisition.options(**options))


OTHERS = {
    "lidar-tracking": {"ranges": (50.0,), "matcher": ("projective",)},
    "lidar-robustness": {"ranges": (50.0,), "method": ("global",)},
    "lidar-range": {"ranges": (80.0,), "method": (paper.TM,), "steps": (60.0,), "scan_steps": (1.0,)},
    "lidar-acceptance": {"ranges": (50.0,), "method": (paper.TM,), "steps": (60.0,), "target": (TARGET,)},
}


@pytest.mark.parametrize("name", OTHERS)
def test_a_row_of_every_campaign_has_the_columns_of_its_schema_and_a_place_in_its_tables(name, monkeypatch):
    monkeypatch.setattr(tracking, "FRAMES", 5)
    campaign = find_campaign(name)
    results = []
    for cell in campaign.cells(campaign.options(**{"target": (TARGET,), **OTHERS[name]})):
        row = campaign.trial(cell, 7, 0)
        assert set(row) == set(campaign.schema)
        frame = pl.DataFrame([row], schema=campaign.schema)
        results.append(CellResult(cell, frame, campaign.summarise(cell, frame)))
    json.dumps([result.summary for result in results])
    _check_sections(campaign.sections(results))


def test_success_over_the_step_has_a_line_for_each_position():
    frame = pl.DataFrame([{"nn_success": True, "ns_success": False}])
    options = lidar_trajectory.options(
        centroid="both", eq4="usual", method=(paper.TM,), steps=(60.0, 30.0), target=(TARGET,)
    )
    (figure,) = figures_over_steps([CellResult(c, frame, {}) for c in lidar_trajectory.cells(options)])
    assert {trace.name: len(trace.x) for trace in figure.data} == {
        f"centroid {position}, {icp}": 2 for position in ("plain", "offset") for icp in ("NN", "NS")
    }


def test_success_over_the_range_has_a_line_for_each_step_of_the_templates():
    campaign = find_campaign("lidar-range")
    options = OTHERS["lidar-range"] | {"steps": (60.0, 30.0)}
    frame = pl.DataFrame(schema=campaign.schema)
    results = [
        CellResult(cell, frame, campaign.summarise(cell, frame))
        for cell in campaign.cells(campaign.options(**options))
    ]
    (figure,) = campaign.sections(results)[0].figures
    assert [trace.name for trace in figure.data] == [
        f"templates {step} deg, detection {detection}" for step in (60, 30) for detection in ("off", "on")
    ]


def test_what_is_accepted_is_wrong_wherever_something_else_was_scanned():
    slim = AcceptanceCell(
        target=TARGET, scanned_target="envisat-slim", method=paper.TM, step_deg=60.0, range_m=50.0
    )
    row = acceptance.run(slim, 7, 0)
    assert row["wrong"]
    assert 40.0 < row["scanned_range_m"] < 50.0  # the smaller one stands nearer


def test_a_curve_of_shares_runs_from_none_to_all_and_is_perfect_where_a_score_separates():
    wrong = np.array([True, True, False, False])
    false, true = roc(np.array([0.1, 0.2, 0.8, 0.9]), wrong)
    assert (false, true) == ([0.0, 0.0, 0.0, 0.5, 1.0], [0.0, 0.5, 1.0, 1.0, 1.0])
    assert roc(np.array([-np.inf, 0.9, 0.8, 0.1]), wrong)[0] == [0.0, 0.5, 0.5, 0.5]


def test_the_scan_window_holds_the_bounding_sphere():
    radius_m = cached_target(TARGET).radius_m
    assert window_deg(TARGET, 20.0) == 40.0
    for range_m in (80.0, 120.0):
        half_deg = window_deg(TARGET, range_m) / 2.0
        assert range_m * np.sin(np.radians(half_deg)) >= radius_m
        assert range_m * np.sin(np.radians(half_deg - 1.0)) < radius_m


def test_a_disturbed_world_differs_in_what_its_name_says():
    pose = make_pose(translation_m=[0, 0, 30])
    exact = lidar_config(noise={"sigma_range_m": 0.0, "sigma_pointing_rad": 0.0, "outlier_share": 0.0})
    spans_m = [
        np.ptp(scan_of(emulator_of(TARGET, exact, 1, scale=scale), pose, trial=0).returns_m[:, 2])
        for scale in (1.0, 1.01)
    ]
    assert spans_m[1] == pytest.approx(1.01 * spans_m[0], abs=0.02)
    returned = [
        len(scan_of(emulator_of(TARGET, lidar_config(detection=world), 1), pose, trial=0).returns_m)
        for world in ({"returned": "all"}, {}, {"threshold": "printed"})
    ]
    assert returned[0] >= returned[1] >= returned[2]


def test_a_pose_that_an_exact_symmetry_turns_into_the_truth_is_right():
    truth = make_pose(
        rotation=Rotation.from_euler("ZYX", [40, 20, 10], degrees=True), translation_m=[1, 2, 30]
    )
    for name, turns in (("rocket-stage", 8), ("hexagonal-body", 12), (TARGET, 1)):
        target = cached_target(name)
        assert len(target.turns(exact=True)) == turns - 1
        turned = truth * make_pose(rotation=Rotation.from_euler("x", 180.0, degrees=True))
        expected_deg = 180.0 if turns == 1 else 0.0
        assert errors(truth, turned, target) == pytest.approx((expected_deg, 0.0), abs=1e-6)


def test_a_pose_of_template_matching_is_checked_by_the_facility():
    cell = AcceptanceCell(target=TARGET, scanned_target=TARGET, method=paper.TM, step_deg=60.0, range_m=50.0)
    rows = [acceptance.run(cell, 7, trial) for trial in range(6)]
    for row in rows:
        assert set(row) == set(acceptance.SCHEMA)
        assert row["accepted"] == (not row["wrong"])
        assert (row["deficit_per_return"] > 0.5) == row["wrong"]
    assert 0 < sum(row["wrong"] for row in rows) < 6


def test_a_tau_of_the_sweep_is_the_fast_variant_with_that_tau():
    tau, step_deg, range_m = 0.1, 60.0, 20.0
    swept = find_campaign("template-tau")
    (cell,) = swept.cells(
        swept.options(taus=(0.5, tau), steps=(step_deg,), ranges=(range_m,), target=(TARGET,))
    )
    assert cell.taus == (tau, 0.5)
    fast = lidar_acquisition.options(
        method=(paper.FAST_TM,), steps=(step_deg,), ranges=(range_m,), target=(TARGET,)
    )
    (fast_cell,) = lidar_acquisition.cells(fast)
    rows = []
    for trial in range(5):
        of_sweep = swept.trial(cell, 7, trial)
        of_fast = acquisition.run(fast_cell, 7, trial)
        assert [row["tau"] for row in of_sweep] == list(cell.taus)
        assert of_sweep[0]["success"] == of_fast["success"]
        assert of_sweep[0]["excluded_share"] == pytest.approx(of_fast["excluded_share"])
        rows += [{"cell": 0, "trial": trial, **row} for row in of_sweep]
    frame = pl.DataFrame(rows)
    summary = swept.summarise(cell, frame)
    assert summary["trials"] == 5
    assert summary["success_rate"][0] == frame.filter(pl.col("tau") == tau)["success"].mean()
    _check_sections(swept.sections([CellResult(cell, frame, summary)]))
