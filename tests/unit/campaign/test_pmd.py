import json
from dataclasses import asdict, replace

import numpy as np
import polars as pl
import pytest
from pydantic import ValidationError

from rpod.scenarios import find, shipped
from rpod_campaign.catalogue import find as find_campaign
from rpod_campaign.engine.campaign import CellResult
from rpod_campaign.engine.folder import CampaignFolder
from rpod_campaign.engine.trial.streams import stream
from rpod_campaign.engine.trial.targets import cached_target
from rpod_campaign.papers import paper_2018 as paper
from rpod_campaign.pmd import sequence
from rpod_campaign.pmd.cells import CALIBRATED_WIGGLING
from rpod_campaign.pmd.methods import EVERY_POSE, pmd_input
from rpod_campaign.pmd.poses import FRONT_DEG, drawn
from rpod_campaign.pmd.report.summary import AXES, summarise
from rpod_campaign.pmd.scene import Stage, off, scenario_of, times_s
from rpod_campaign.pmd.sequence import SequenceCell
from rpod_campaign.pmd.world import World, built, disturbed, glints
from rpod_campaign.pmd_acceptance import trial as acceptance
from rpod_campaign.pmd_acceptance.campaign import CASES as SHOWN
from rpod_campaign.pmd_acquisition import trial as acquisition
from rpod_campaign.pmd_acquisition.campaign import CASES as VIEWS
from rpod_campaign.pmd_robustness.trial import CASES
from rpod_campaign.pmd_tracking.pictures import picture
from rpod_schemas.errors import ConfigurationError
from rpod_schemas.poses import pose_error

pmd_acquisition = find_campaign("pmd-acquisition")
pmd_robustness = find_campaign("pmd-robustness")
pmd_sun = find_campaign("pmd-sun")
pmd_tracking = find_campaign("pmd-tracking")
pmd_acceptance = find_campaign("pmd-acceptance")
SCENARIOS = {name: find(name) for name in shipped()}
TARGET = "mockup"


def cells(campaign=pmd_tracking, **options) -> list[SequenceCell]:
    return list(campaign.cells(campaign.options(scenarios=SCENARIOS, **options)))


def shortened(cell: SequenceCell, duration_s: float) -> SequenceCell:
    """Return a cell whose scenario ends early, at the same speed."""
    scenario = scenario_of(cell.document)
    way = scenario.motion.trajectory
    share = duration_s / scenario.duration_s
    end_m = way.start_m + share * (way.end_m - way.start_m)
    motion = scenario.motion.model_copy(update={"trajectory": way.model_copy(update={"end_m": end_m})})
    document = scenario.model_copy(update={"motion": motion, "duration_s": duration_s}).model_dump_json()
    return replace(cell, document=document)


@pytest.fixture(scope="module")
def followed():
    """Return a short sequence of a quick method, and its rows."""
    (cell,) = cells(scenario=("tumbling",), method=("signed-distance",))
    cell = shortened(cell, 4.0)
    return cell, sequence.run(cell, 7, 0)


def frame_of(rows: list[dict]) -> pl.DataFrame:
    return pl.DataFrame([{"cell": 0, "trial": 0, **row} for row in rows], schema_overrides=sequence.SCHEMA)


def test_the_papers_sequences_are_twenty_images_one_second_apart_and_45_a_second_in_full():
    for name in (paper.OBLIQUE, paper.TUMBLING):
        scenario = SCENARIOS[f"mockup-{name}"]
        assert times_s(scenario, "keyframes") == [float(k) for k in range(paper.IMAGES)]
        full = times_s(scenario, "full")
        assert len(full) == 900
        assert np.diff(full) == pytest.approx(1.0 / 45.0)


def test_the_scenarios_are_those_that_the_facility_plays():
    chosen = cells(method=("signed-distance",))
    assert [cell.scenario for cell in chosen] == ["oblique", "tumbling", "approach"]
    for cell in chosen:
        assert scenario_of(cell.document).name == f"mockup-{cell.scenario}"
        assert scenario_of(cell.document).model_dump_json() == cell.document
    assert cells(scenario=("mockup-oblique",), method=("signed-distance",))[0] == chosen[0]


def test_the_third_scenario_goes_from_10_m_to_1_m_with_a_camera_that_sees_so_far():
    scenario = SCENARIOS["mockup-approach"]
    stage = Stage(scenario, World(), seed=1, trial=0)
    ranges_m = [
        float(np.linalg.norm(stage.truth(time_s).translation)) for time_s in (0.0, scenario.duration_s)
    ]
    assert ranges_m == pytest.approx([10.0, 1.0], abs=0.01)
    first = stage.take(0.0)
    depth_m = first.frame.depth_m[first.seen]
    assert np.nanmedian(depth_m) == pytest.approx(9.95, abs=0.35)


def test_calibrated_depth_has_little_of_the_wiggling_and_raw_depth_all_of_it():
    raw, calibrated = cells(scenario=("oblique",), method=("signed-distance",), depth="both")
    assert (raw.case, calibrated.case) == ("raw", "calibrated")
    left, right = (scenario_of(cell.document).sensors[0].pixel.wiggling_share for cell in (raw, calibrated))
    assert (left, right) == (0.03, CALIBRATED_WIGGLING)


def test_table_2_has_nine_radii_in_both_scenarios_and_other_comparisons_one():
    chosen = cells(method=("icp-reverse-calibration",), frames="both")
    for through in ("tracker", "truth"):
        mine = [c for c in chosen if c.frames == "keyframes" and c.through == through]
        assert [(c.scenario, c.radius_px) for c in mine if c.scenario != "approach"] == list(paper.RMS)
    assert {c.radius_px for c in chosen if c.frames == "full" or c.scenario == "approach"} == {25}


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"scenario": ("envisat-station",)}, "--scenario: needs .*tumbling, not 'envisat-station'"),
        ({"method": ("kalman",)}, "--method: needs .*joint.*, not 'kalman'"),
        ({"method": ("signed-distance",), "radius": (10,)}, "--radius: has no meaning for signed-distance"),
    ],
)
def test_an_option_that_cannot_be_met_is_named(options, reason):
    with pytest.raises(ConfigurationError, match=reason):
        cells(**options)


def test_the_paper_icp_is_point_to_point_and_ours_to_planes():
    for method, metric in (
        ("icp-reverse-calibration", "point_to_point"),
        ("icp-reverse-calibration-plane", "point_to_plane"),
    ):
        tracking = sequence.pmd_input(method, radius_px=40).tracking
        assert (tracking.metric, tracking.radius_px) == (metric, 40)


def test_every_frame_of_a_sequence_is_a_row_with_its_errors_in_both_axes(followed):
    _, rows = followed
    assert [row["frame"] for row in rows] == list(range(4))
    for row in rows:
        assert set(row) == set(sequence.SCHEMA)
        for names in (("x_m", "y_m", "z_m"), ("target_x_m", "target_y_m", "target_z_m")):
            assert np.linalg.norm([row[name] for name in names]) == pytest.approx(row["position_m"])
        for prefix in ("", "sensor_"):
            angles = [row[f"{prefix}{name}_deg"] for name in ("roll", "pitch", "yaw")]
            assert np.linalg.norm(angles) == pytest.approx(row["attitude_deg"])
        # the mock-up's x axis points at the camera: what is depth there is along -x here
        assert row["target_x_m"] == pytest.approx(-row["z_m"], abs=0.2 * row["position_m"] + 1e-9)
        assert row["attitude_deg"] < 3.0
        assert row["measured"]


def test_a_sequence_is_the_same_whoever_runs_it_and_another_trial_is_another(followed):
    cell, rows = followed
    again, other = sequence.run(cell, 7, 0), sequence.run(cell, 7, 1)
    assert [row["found"] for row in again] == [row["found"] for row in rows]
    assert other[0]["found"] != rows[0]["found"]
    assert other[0]["truth"] == rows[0]["truth"]


def test_a_keyframe_is_the_same_frame_in_the_full_sequence(followed):
    cell, _ = followed
    stage = Stage(scenario_of(cell.document), World(), seed=7, trial=0)
    one = stage.take(1.0).frame
    stage.take(1.0 + 1.0 / 45.0)
    np.testing.assert_array_equal(stage.take(45.0 / 45.0).frame.depth_m, one.depth_m)


def test_the_summary_is_what_the_command_prints(followed):
    cell, rows = followed
    summary = json.loads(json.dumps(summarise(cell, frame_of(rows)), allow_nan=False))
    assert {
        "scenario",
        "method",
        "radius_px",
        "frames",
        "rms",
        "norms",
        "max",
        "median_s",
        "p95_s",
        "lost",
        "success_rate",
        "trials",
        "wrong_accepted",
        "ambiguous",
    } <= set(summary)
    assert set(summary["rms"]) == {"roll_deg", "pitch_deg", "yaw_deg", "x_m", "y_m", "z_m"}
    assert summary["frames"] == 4
    norm = np.linalg.norm([summary["rms"][name] for name in ("roll_deg", "pitch_deg", "yaw_deg")])
    assert summary["norms"]["attitude_deg"] == pytest.approx(norm)
    assert summary["lost"] == 0


def test_a_frame_without_a_pose_and_a_frame_far_off_are_both_lost_and_counted_once(followed):
    cell, rows = followed
    changes = ({"measured": False}, {"off_target": True}, {"measured": False, "off_target": True}, {})
    frame = frame_of([row | change for row, change in zip(rows, changes, strict=True)])
    summary = summarise(cell, frame)
    assert (summary["lost"], summary["lost_without_pose"], summary["lost_off_target"]) == (3, 2, 2)


def test_where_the_tracker_gives_nothing_the_last_pose_stays(followed):
    cell, _ = followed
    blind = replace(cell, world=World(depth_lost_share=1.0))
    rows = sequence.run(blind, 7, 0)
    assert not any(row["measured"] for row in rows)
    assert len({tuple(row["found"]) for row in rows}) == 1
    assert all(row["reason"] for row in rows)
    assert all(row["nees"] is None for row in rows)


def test_from_the_last_true_pose_one_failure_does_not_make_the_next(followed):
    cell, _ = followed
    blind = replace(cell, world=World(depth_lost_share=1.0), through="truth")
    rows = sequence.run(blind, 7, 0)
    assert [row["found"] for row in rows[1:]] == [row["truth"] for row in rows[:-1]]


def test_the_navigator_follows_as_well(followed):
    cell, _ = followed
    rows = sequence.run(replace(shortened(cell, 4.0), through="navigator"), 7, 0)
    assert all(row["measured"] for row in rows)  # the first frame has the stamp 0, and counts
    assert rows[-1]["attitude_deg"] < 3.0


def test_the_report_lays_our_numbers_beside_the_printed_ones(followed):
    cell, rows = followed
    named = replace(cell, method=paper.ICP, radius_px=25)
    frame = frame_of([row | {"frame": row["frame"] + 3} for row in rows])  # images 4 to 7
    sections = pmd_tracking.sections([CellResult(named, frame, summarise(named, frame))])
    table_2 = next(section for section in sections if "Table 2" in section.title).tables[0]
    (row,) = table_2.rows
    assert row[0] == "25"
    assert row[3] == f"{summarise(named, frame)['rms']['yaw_deg']:.2f} / 0.526"
    assert row[7].endswith(" / 4.2")
    table_4 = next(section for section in sections if "Tables 3" in section.title).tables[0]
    assert [value.partition(" / ")[2] for value in table_4.rows[0][1:]] == [
        "15.73", "0.39", "25.91", "0.6", "23.27", "0.49",
    ]  # fmt: skip
    assert table_4.rows[0][5].startswith("-")  # image 9 was not taken
    assert next(section for section in sections if "Figs. 10" in section.title).figures


def test_a_misbuilt_target_is_off_by_about_what_is_said_and_its_body_stays():
    target = cached_target(TARGET)
    moved = built(target, World(cad_error_m=0.003), stream(1, 0))
    body = target.triangle_part == 0
    offset_m = moved.triangles_m - target.triangles_m
    assert abs(offset_m[body].reshape(-1, 3).mean(axis=0)).max() < 0.003
    away_m = [
        np.ptp(offset_m[target.triangle_part == part], axis=(0, 1)).max() for part in range(len(target.parts))
    ]
    assert 1e-4 < max(away_m) < 0.012
    assert np.linalg.norm(offset_m, axis=-1).max() < 0.02
    np.testing.assert_allclose(np.linalg.norm(moved.normals, axis=1), 1.0)
    assert built(target, World(), stream(1, 0)) is target


def test_a_coat_covers_everything():
    coated = built(cached_target(TARGET), World(coat="gold-mli"), stream(1, 0))
    (index,) = set(coated.triangle_material.tolist())
    assert coated.materials[index].name == "gold-mli"


def test_depth_is_lost_without_the_amplitude_and_glints_take_both():
    stage = Stage(SCENARIOS["mockup-tumbling"], World(), seed=1, trial=0)
    shot = stage.take(18.0)
    lost = disturbed(shot.frame, World(depth_lost_share=0.6), stream(1, 0), seen=shot.seen)
    kept = np.isfinite(lost.depth_m[shot.seen]).sum() / np.isfinite(shot.frame.depth_m[shot.seen]).sum()
    assert 0.2 < kept < 0.6
    np.testing.assert_array_equal(lost.amplitude, shot.frame.amplitude)
    wiped = glints(shot.seen, 0.4, stream(1, 0))
    assert 0.4 <= wiped[shot.seen].mean() < 0.47
    dazzled = disturbed(shot.frame, World(glint_share=0.4), stream(1, 0), seen=shot.seen)
    assert not np.isfinite(dazzled.depth_m[wiped]).any()
    assert not dazzled.amplitude[wiped].any()
    np.testing.assert_array_equal(dazzled.amplitude[~wiped], shot.frame.amplitude[~wiped])


def test_the_worlds_share_their_frames_and_a_calibrated_camera():
    chosen = {cell.case: cell for cell in cells(pmd_robustness, method=("signed-distance",))}
    assert list(chosen) == list(CASES)
    for cell in chosen.values():
        scenario = scenario_of(cell.document)
        assert scenario.sensors[0].pixel.wiggling_share == CALIBRATED_WIGGLING
        assert cell.frames == "full"
    pair = chosen[CASES["depth-lost"].pair]
    assert pair.document == chosen["depth-lost"].document
    assert scenario_of(chosen["close"].document).motion.trajectory.end_m[2] == 1.0


def test_a_paired_case_is_told_by_how_much_its_error_rises(followed):
    cell, rows = followed
    errors = (*AXES, "attitude_deg", "position_m")
    twice = [row | {name: 2.0 * row[name] for name in errors} for row in rows]
    results = []
    for case, made in (("cad-1mm", rows), ("depth-lost", twice)):
        named = replace(cell, case=case)
        results.append(CellResult(named, frame_of(made), summarise(named, frame_of(made))))
    paired = next(s for s in pmd_robustness.sections(results) if s.title == "Paired")
    (table,) = paired.tables
    assert "case depth-lost" in table.title
    assert table.rows == (("cad-1mm", *["+100.0"] * 8),)


def test_the_sun_is_where_the_cell_says():
    chosen = cells(pmd_sun, method=("signed-distance",), case=("gold-mli",))
    assert len(chosen) == 2 + 5 * 4
    assert len(set(map(str, map(asdict, chosen)))) == len(chosen)
    for cell in chosen:
        direction = np.array(scenario_of(cell.document).motion.sun.direction)
        assert direction @ (0.0, 0.0, 1.0) == pytest.approx(np.cos(np.deg2rad(cell.angle_deg)), abs=1e-12)
    right = next(cell for cell in chosen if (cell.angle_deg, cell.azimuth_deg) == (90.0, 0.0))
    assert scenario_of(right.document).motion.sun.direction == pytest.approx([1.0, 0.0, 0.0], abs=1e-12)


def test_a_front_view_shows_the_front_and_a_wide_start_is_as_wide_as_is_said():
    target = cached_target(TARGET)
    for trial in range(200):
        pose = drawn(target, "front", (3.0, 6.0), stream(2, trial))
        towards = pose.rotation.apply((1.0, 0.0, 0.0))
        assert -towards[2] >= np.cos(np.deg2rad(FRONT_DEG)) - 1e-9
        start = off(pose, stream(2, trial, 1), angle_deg=25.0, distance_m=0.5)
        attitude_rad, position_m = pose_error(pose, start)
        assert np.rad2deg(np.linalg.norm(attitude_rad)) == pytest.approx(25.0)
        assert np.linalg.norm(position_m) == pytest.approx(0.5)


def test_a_trial_of_acquisition_fills_every_column_and_is_counted():
    (cell,) = pmd_acquisition.cells(pmd_acquisition.options(scenarios=SCENARIOS, case=("front-wide",)))
    row = acquisition.run(cell, 7, 0)
    assert set(row) == set(acquisition.SCHEMA)
    assert row["acquire_s"] > 0.0
    changes = (
        {"success": True, "accepted": True},
        {"success": True, "accepted": False, "reason": "cost 0.1"},
        {"success": False, "accepted": True},
    )
    rows = pl.DataFrame([row | change for change in changes], schema=acquisition.SCHEMA)
    summary = pmd_acquisition.summarise(cell, rows)
    assert summary["success_rate"] == pytest.approx(2 / 3)
    assert (summary["wrong_accepted"], summary["right_refused"]) == (1, 1)
    json.dumps(summary)


def test_rows_of_one_trial_are_kept_apart_by_their_keys(tmp_path):
    manifest = {"campaign": "keyed"}
    folder = CampaignFolder.open(tmp_path, manifest, {"frame": pl.Int64}, keys=("frame",))
    rows = [{"cell": 0, "trial": 0, "frame": frame} for frame in (2, 0, 1)]
    folder.add(rows)
    folder.add(rows)
    assert folder.close()["frame"].to_list() == [0, 1, 2]


def test_pictures_show_depth_and_amplitude_under_the_wireframe(followed):
    cell, rows = followed
    figure = picture([CellResult(cell, frame_of(rows), {})], number=2)
    assert len(figure.layout.images) == 2
    assert {trace.name.split(":")[0] for trace in figure.data} == {"truth", "signed-distance"}
    line = figure.data[0]
    assert np.isfinite(np.asarray(line.x, float)).sum() > 20


def test_an_acceptance_campaign_counts_right_frames_and_frames_of_something_else():
    chosen = cells(pmd_acceptance, case=("right", "size-1.1"))
    assert [cell.spoiled for cell in chosen] == [False, True]
    results = []
    for cell in chosen:
        rows = pl.DataFrame([acceptance.run(cell, 3, 0)], schema_overrides=acceptance.SCHEMA)
        results.append(CellResult(cell, rows, pmd_acceptance.summarise(cell, rows)))
    right, larger = (result.summary for result in results)
    assert (right["acquisition_accepted"], right["tracker_accepted"]) == (1, 1)
    assert (right["acquisition_right"], right["tracker_right"]) == (1, 1)
    assert (larger["acquisition_accepted"], larger["tracker_accepted"]) == (0, 0)
    assert results[0].rows["tracker_alike"].to_list() == [True]
    titles = [section.title for section in pmd_acceptance.sections(results)]
    assert titles == ["Right frames", "Frames of other objects"]


def test_the_cases_of_the_command_line_are_those_of_the_trials():
    for campaign, known in ((pmd_robustness, CASES), (pmd_acquisition, VIEWS), (pmd_acceptance, SHOWN)):
        assert campaign.options().case == tuple(known)
    with pytest.raises(ValidationError, match="sideways"):
        cells(pmd_acceptance, case=("sideways",))


@pytest.mark.parametrize("method", ["icp-reverse-calibration", "signed-distance"])
def test_beside_a_paper_every_pose_is_followed(method):
    limited, followed = (pmd_input(method, limited=limited).tracking for limited in (True, False))
    parts = [getattr(each, "tuning", each) for each in (limited, followed)]
    limits = [getattr(part, "acceptance", None) for part in parts]
    assert limits[1] == EVERY_POSE != limits[0]
    assert pmd_input("joint", limited=False) == pmd_input("joint")
