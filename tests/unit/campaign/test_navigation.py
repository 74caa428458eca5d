"""The campaign of scenarios through the navigator."""

from dataclasses import replace

import numpy as np
import polars as pl
import pytest
from pmd_frames import TINY

from rpod.scenarios import find
from rpod_campaign.engine.campaign import CellResult
from rpod_campaign.engine.trial.targets import cached_target
from rpod_campaign.navigation import trial
from rpod_campaign.navigation.campaign import cells
from rpod_campaign.navigation.driven_motion import DrivenMotion
from rpod_campaign.navigation.options import Options
from rpod_campaign.navigation.report import over_trials, sections, summarise
from rpod_campaign.navigation.trial import SCHEMA, NavigationCell
from rpod_campaign.pmd.scene import scenario_of
from rpod_campaign.pmd.world import World
from rpod_schemas.config.estimator.filter import FilterConfig
from rpod_schemas.config.motion import JointMotionConfig
from rpod_schemas.errors import ConfigurationError
from rpod_schemas.poses import make_pose
from rpod_schemas.types import PmdFrame

STATION = find("envisat-station")
MOVING = STATION.motion.model_copy(update={"joints": {"array": JointMotionConfig(angle_deg=10.0)}})
CELL = NavigationCell(scenario="made-up", target="mockup", seconds=8.0)


def row(trial_number, frame, **given):
    usual = {
        "trial": trial_number, "frame": frame, "time_s": frame / 2.0, "since_s": frame / 2.0, "sensor": "pmd",
        "range_m": 5.0, "mode": "TRACKING", "accepted": True, "available": True, "attitude_error_deg": 0.1,
        "position_error_m": 0.01, "nees": 6.0, "nees_dof": 6, "nis": 6.0, "change_deg": 0.0, "change_m": 0.0,
        "jump_deg": 0.0, "jump_m": 0.0, "seed": 1,
    }  # fmt: skip
    return usual | given


def rows(*given):
    return pl.DataFrame(list(given), schema={"trial": pl.Int64, **SCHEMA})


def options(**given):
    scenario = given.pop("shown", STATION)
    return Options(**{"scenario": (scenario.name,), "scenarios": {scenario.name: scenario}} | given)


def test_the_interval_is_that_of_trials_whose_frames_err_together():
    wide = rows(*(row(k, frame, nees=float(k)) for k in range(10) for frame in range(1, 40)))
    mean = over_trials(wide, "nees")
    assert mean.value == pytest.approx(4.5)
    assert mean.high - mean.low == pytest.approx(2 * 1.96 * np.std(np.arange(10)) / np.sqrt(10), rel=0.15)


def test_the_first_quarter_and_frames_without_a_number_are_not_scored():
    early, late = row(0, 0, nees=100.0), row(0, 8, nees=20.0)
    found = summarise(CELL, rows(early, late, row(0, 9, nees=6.0, nis=float("nan"))))
    assert found["frames"] == 2
    assert found["nees"]["mean"] == pytest.approx(13.0)
    assert found["nees_inside"]["mean"] == pytest.approx(0.5)
    assert found["nis_inside"]["mean"] == pytest.approx(1.0)


def test_a_handover_is_the_first_frame_of_a_sensor_while_another_is_used():
    found = summarise(
        CELL,
        rows(
            row(0, 0, sensor="lidar"),
            row(0, 1, sensor="lidar"),
            row(0, 2, accepted=False, jump_m=0.5),
            row(0, 3, change_m=0.03, jump_m=0.02, change_deg=0.4, jump_deg=0.1),
            row(0, 4, sensor="lidar", jump_m=9.0),  # its own last frame was 1.5 s before
        ),
    )
    handovers = found["handovers"]
    assert (handovers["count"], handovers["gap_s"]) == (1, 1.0)
    assert handovers["jump_m"] == 0.5  # an estimate between both frames counts too
    assert handovers["jump_deg"] == 0.1


@pytest.mark.parametrize(("mode", "ends"), [("TRACKING", 0), ("COASTING", 0), ("LOST", 1), ("VERIFYING", 1)])
def test_a_trial_that_coasts_at_its_end_has_a_track(mode, ends):
    found = summarise(CELL, rows(row(0, 7, mode="LOST"), row(0, 8, mode=mode)))
    assert found["ends_without_track"] == ends


def test_a_handover_without_an_estimate_before_it_has_no_change():
    unknown = dict.fromkeys(("change_deg", "change_m", "jump_deg", "jump_m"))
    found = summarise(CELL, rows(row(0, 0, sensor="lidar", **unknown), row(0, 1, **unknown)))
    assert (found["handovers"]["count"], found["handovers"]["jump_m"]) == (1, None)


def test_the_report_shows_how_the_trials_are_spread():
    frame = rows(*(row(k, frame, nees=float(k)) for k in range(10) for frame in range(4, 8)))
    (section,) = sections([CellResult(CELL, frame, summarise(CELL, frame))])
    (line,) = section.figures[0].data
    assert (line.x[4], line.y[4]) == (4.0, 0.5)
    assert [table.title for table in section.tables] == [section.tables[0].title]  # no handover, no table


def test_a_trial_gives_estimates_that_are_scored():
    (cell,) = cells(options(seconds=3.0))
    found = trial.run(cell, seed=1, trial=0)
    assert found == trial.run(cell, seed=1, trial=0)
    assert [set(each) for each in found] == [set(SCHEMA)] * len(found)
    assert len(found) == 3
    assert all(each["accepted"] and each["attitude_error_deg"] < 1.0 for each in found)
    other = trial.run(cell, seed=1, trial=1)
    assert other[0]["time_s"] != found[0]["time_s"]


@pytest.mark.parametrize("misbuilt", ["parts", "surface"])
def test_a_trial_with_a_target_that_is_off_has_a_model_that_says_so(misbuilt):
    (cell,) = cells(options(seconds=2.0, off_mm=(30.0,), misbuilt=(misbuilt,)))
    off, exact = trial.run(cell, 1, 0), trial.run(cells(options(seconds=2.0))[0], 1, 0)
    assert off[-1]["position_error_m"] != exact[-1]["position_error_m"]
    assert off[-1]["nees"] < 40.0


def test_a_rate_of_cameras_makes_no_more_cells_of_a_scenario_without_one():
    given = {"rate": (5.0, 15.0), "scenario": ("envisat-station", "mockup-oblique")}
    both = {name: find(name) for name in given["scenario"]}
    found = [(cell.scenario, cell.rate_hz) for cell in cells(options(**given, scenarios=both))]
    assert found == [("envisat-station", None), ("mockup-oblique", 5.0), ("mockup-oblique", 15.0)]


@pytest.mark.parametrize(
    ("given", "named"),
    [
        ({"scenario": ("other",)}, "--scenario: needs the path"),
        ({"target": ("no-such-target",)}, "--target"),
        ({"case": ("close",)}, "--case: 'close' needs a camera"),
        ({"shown": STATION.model_copy(update={"motion": MOVING})}, "has joints that move"),
    ],
)
def test_a_wrong_option_is_named(given, named):
    with pytest.raises(ConfigurationError, match=named):
        cells(options(**given))


def test_a_case_of_the_robustness_campaign_is_played_with_its_range_and_its_camera():
    tumbling = find("mockup-tumbling")
    given = {"shown": tumbling, "case": ("scenario", "nominal", "glints", "close"), "misbuilt": ("surface",)}
    as_it_is, nominal, glints, close = cells(options(**given))
    assert scenario_of(as_it_is.document).model_dump_json() == tumbling.model_dump_json()
    assert [cell.off_mm for cell in (as_it_is, nominal, glints, close)] == [0.0, 0.0, 1.0, 1.0]
    assert (glints.misbuilt, glints.pixels) == ("surface", World(glint_share=0.4))
    assert scenario_of(nominal.document).estimator.sensors[0].calibration is not None
    assert scenario_of(nominal.document).motion.trajectory.end_m[2] == pytest.approx(2.1)
    assert scenario_of(close.document).motion.trajectory.start_m[2] == pytest.approx(2.1)


def test_images_lose_the_pixels_of_a_case():
    image = np.ones((TINY.height, TINY.width), dtype=np.float32)
    frame = PmdFrame(stamp_ns=0, frame_id="pmd_optical", depth_m=image, amplitude=image, camera=TINY)
    target, ahead = cached_target("mockup"), make_pose(translation_m=(0.0, 0.0, 4.0))
    rng = np.random.default_rng(3)
    assert trial.without_pixels(frame, World(), target, ahead, rng) is frame
    lost = trial.without_pixels(frame, World(depth_lost_share=0.5), target, ahead, rng)
    assert 0.2 < np.isnan(lost.depth_m).mean() < 0.8
    assert np.array_equal(lost.amplitude, image)
    wiped = trial.without_pixels(frame, World(glint_share=0.4), target, ahead, rng)
    assert np.isnan(wiped.depth_m).any()
    assert (wiped.amplitude[np.isnan(wiped.depth_m)] == 0.0).all()


def test_the_surface_of_a_misbuilt_target_is_off_by_the_stated_deviation_in_each_coordinate():
    target = cached_target("envisat-mesh")
    cell = NavigationCell(scenario="made-up", target=target.name, seconds=1.0, off_mm=3.0, misbuilt="surface")
    moved_m = [trial.misbuilt(cell, target, np.random.default_rng(i)).triangles_m for i in range(20)]
    off_m = np.stack(moved_m) - target.triangles_m
    assert off_m.std(axis=(0, 1, 2)) == pytest.approx([0.003] * 3, rel=0.25)


def test_stated_mounts_are_drawn_as_the_filter_expects_them():
    mounts = find("mockup-mounts")
    cell = replace(CELL, mounts="drawn")
    true = mounts.sensors[1].T_chaser_sensor
    stated = [trial.stated_mounts(cell, mounts, np.random.default_rng(i))["pmd"] for i in range(100)]
    off_m = np.array([each.translation - true.translation for each in stated])
    turn_deg = np.degrees([(each.rotation * true.rotation.inv()).magnitude() for each in stated])
    assert off_m.std() == pytest.approx(0.015, rel=0.15)
    assert np.sqrt((turn_deg**2).mean() / 3.0) == pytest.approx(0.2, rel=0.15)


def test_a_driven_motion_accelerates_as_the_filter_states():
    config, calm = FilterConfig(), trial.motion_of(STATION)
    given = {"begin_s": 1.0, "seconds": 2.0}
    ends = []
    for seed in range(60):
        driven = DrivenMotion.drawn(calm, config, np.zeros(3), np.random.default_rng(seed), **given)
        assert np.allclose(
            driven.state(1.0).T_chaser_target.as_matrix(), calm.state(1.0).T_chaser_target.as_matrix()
        )
        true, moved = (each.state(3.0).T_chaser_target for each in (calm, driven))
        turn = (moved.rotation * true.rotation.inv()).as_rotvec()
        ends.append([moved.translation - true.translation, turn])
    densities = config.acceleration_density_m2_s3, config.angular_acceleration_density_rad2_s3
    assert np.square(ends).mean(axis=(0, 2)) == pytest.approx(np.array(densities) * 2.0**3 / 3.0, rel=0.25)
