"""The campaign over random satellites: scenes for a target of any size, and how an answer is counted."""

import json
import math
from dataclasses import replace

import numpy as np
import polars as pl
import pytest
from pydantic import ValidationError
from scipy.spatial.transform import Rotation

from rpod.campaign.command import campaign_command
from rpod.scenarios import find, shipped
from rpod_campaign.engine.campaign import CellResult
from rpod_campaign.engine.trial.poses import errors, nees_of
from rpod_campaign.engine.trial.sizes import Limits, displaced, middle_m, with_middle_at
from rpod_campaign.engine.trial.streams import stream
from rpod_campaign.engine.trial.targets import cached_target
from rpod_campaign.lidar.returns import scan_with_returns, silhouette_m2, window_of
from rpod_campaign.lidar.scene import emulator_of
from rpod_campaign.pmd.framing import filled_share, framed, range_filling, reaching
from rpod_campaign.pmd.scene import camera_of
from rpod_campaign.population import trial as population
from rpod_campaign.population.campaign import CAMPAIGN
from rpod_campaign.population.options import Options
from rpod_campaign.population.report import sections, summarise, totals
from rpod_campaign.population.trial import PopulationCell
from rpod_pose.belief import Belief, Rival
from rpod_pose.ports import Acquisition, Registration
from rpod_schemas.poses import make_pose
from rpod_schemas.types import BeliefLevel, Source
from rpod_target.population import POPULATIONS, satellite_of

SCENARIOS = {name: find(name) for name in shipped()}
LIDAR = PopulationCell("hexagonal-body", "lidar", "acquisition", (30.0, 500.0))
CAMERA = PopulationCell("hexagonal-body", "pmd", "acquisition", (0.2, 0.8))
PROMISED = {
    "body", "size_m", "triangles", "range_m", "returns", "trials", "success_rate", "ambiguous_rate",
    "wrong_accepted", "right_rejected", "attitude_deg_rms", "position_m_rms", "nees_mean",
    "nees_share_in_95", "median_s",
}  # fmt: skip
"""Keys of each cell of ``population --json``."""
TURNED = Rotation.from_euler("z", 90.0, degrees=True)


def cells(**options):
    return CAMPAIGN.cells(Options(scenarios=SCENARIOS, **options))


def test_a_population_is_named_by_its_seed_and_shares_no_satellite_with_the_other():
    names = {each: [cell.target for cell in cells(population=each, bodies=4, seed=7)] for each in POPULATIONS}
    assert names["report"] == [f"random-report-7-{index}" for index in range(4)]
    assert not set(names["report"]) & set(names["derive"])


def test_a_camera_sees_small_satellites_in_the_light_of_its_scenario():
    (cell,) = cells(sensor="pmd", bodies=1, seed=7)
    assert cell.target == "random-report-7-0-small"
    assert satellite_of(cell.target).size_m < 3.0
    assert json.loads(cell.document)["name"] == "mockup-tumbling"


def test_limits_that_fall_are_refused_by_the_name_of_the_option():
    with pytest.raises(ValidationError, match="returns needs the least value first, not 500,30"):
        cells(returns=(500.0, 30.0))


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"filled": (0.2, 0.8)}, "--filled has no meaning with --sensor lidar; leave it out"),
        ({"sensor": "pmd", "returns": (30.0, 60.0)}, "--returns has no meaning with --sensor pmd"),
        ({"target": ("mockup",), "bodies": 3}, "--bodies has no meaning with --target"),
        ({"sensor": "pmd", "filled": (20.0, 80.0)}, "--filled is 20,80; it needs shares of the image's"),
    ],
)
def test_an_option_that_would_be_ignored_is_refused(options, reason):
    with pytest.raises(ValidationError, match=reason):
        cells(**options)


@pytest.mark.parametrize("name", ["hexagonal-body", "envisat-bulky"])
def test_a_window_holds_the_target_at_every_range_and_no_surface_is_near(name):
    window, target = window_of(name), cached_target(name)
    radius_m = np.linalg.norm(target.triangles_m.reshape(-1, 3) - middle_m(target), axis=1).max()
    assert window.nearest_m - radius_m >= 2.0
    assert math.degrees(math.asin(radius_m / window.nearest_m)) <= window.span_deg / 2.0 + 1e-6
    assert window.range_m(1e9) == window.nearest_m
    assert window_of(name, 60.0) == window
    assert window.config().pattern.step_deg == window.step_deg


def test_the_silhouette_of_a_convex_body_is_a_quarter_of_its_surface():
    target = cached_target("hexagonal-body")
    edges = np.diff(target.triangles_m, axis=1)
    area_m2 = 0.5 * np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1).sum()
    assert silhouette_m2(target, 0.7) == pytest.approx(area_m2 / 4.0, rel=0.08)


@pytest.mark.parametrize(("wanted", "greatest"), [(40.0, 500.0), (250.0, 500.0), (3000.0, 10000.0)])
def test_the_range_of_a_scan_follows_from_the_wanted_returns(wanted, greatest):
    emulator = emulator_of("envisat-bulky", window_of("envisat-bulky", greatest).config(), 7)
    attitude = Rotation.from_euler("xyz", (20.0, 30.0, 40.0), degrees=True)
    pose, scan = scan_with_returns(
        emulator, "envisat-bulky", attitude, returns=wanted, trial=0, greatest=greatest
    )
    assert len(scan.returns_m) == pytest.approx(wanted, rel=0.12)
    assert np.allclose(pose.apply(middle_m(cached_target("envisat-bulky")))[:2], 0.0)


def test_false_returns_are_none_of_the_wanted_ones():
    config, attitude = (
        window_of("mockup").config(),
        Rotation.from_euler("xyz", (20.0, 30.0, 40.0), degrees=True),
    )
    clean, stray = (
        scan_with_returns(
            emulator_of("mockup", config, 7, world=world), "mockup", attitude, returns=15.0, trial=0
        )
        for world in ("documented", "stray-light")
    )
    assert stray[0].translation[2] == pytest.approx(clean[0].translation[2], rel=0.15)
    assert len(stray[1].returns_m) > len(clean[1].returns_m)


@pytest.mark.parametrize("filled", [(0.3, 0.3), (0.7, 0.7)])
def test_a_target_fills_the_wanted_share_of_the_image(filled):
    target, camera = cached_target("mockup"), camera_of(SCENARIOS["mockup-tumbling"])
    for number in range(4):
        pose = framed(target, camera, filled=filled, generator=np.random.default_rng(number))
        near = pose.apply(middle_m(target))[2] < 0.93 * camera.unambiguous_range_m - 1e-6
        share = filled_share(pose, target, camera.camera)
        assert share == pytest.approx(filled[0], rel=0.05) if near else share > filled[0]


def test_a_camera_measures_with_two_frequencies_where_one_is_ambiguous():
    target, scenario = cached_target("mockup"), SCENARIOS["mockup-tumbling"]
    camera = camera_of(scenario)
    profiles = [
        camera_of(reaching(scenario, range_filling(target, filled, camera))).profile for filled in (0.8, 0.2)
    ]
    assert profiles == ["fast", "dual"]


def test_a_displaced_pose_is_off_by_the_angle_and_its_middle_by_the_distance():
    target = cached_target("envisat-bulky")
    truth = with_middle_at(Rotation.identity(), np.array((0.0, 0.0, 30.0)), target)
    off = displaced(truth, stream(7, 0), angle_deg=5.0, distance_m=0.6, target=target)
    assert errors(truth, off, target)[0] == pytest.approx(5.0)
    assert np.linalg.norm(off.apply(middle_m(target)) - (0.0, 0.0, 30.0)) == pytest.approx(0.6)


def test_nees_is_that_against_the_nearest_pose_that_a_symmetry_makes_equal():
    target, truth = cached_target("hexagonal-body"), make_pose(translation_m=(0.0, 0.0, 9.0))
    covariance = np.diag([0.01**2] * 3 + [0.002**2] * 3)
    off = make_pose(rotation=Rotation.from_rotvec([0.002, 0.0, 0.0]), translation_m=(0.01, 0.0, 9.0))
    turn = target.turns(exact=True)[0]
    for found in (off, off * turn):
        assert nees_of(truth, found, covariance, target) == pytest.approx(2.0)
    assert math.isnan(nees_of(truth, None, covariance, target))


@pytest.fixture(scope="module")
def rows():
    return [population.run(LIDAR, 7, trial) for trial in range(3)]


def test_a_row_fills_every_column_and_is_the_same_whoever_runs_it(rows):
    again = population.run(LIDAR, 7, 1)
    assert set(again) == set(population.SCHEMA)
    assert {k: v for k, v in again.items() if k != "took_s"} == {
        k: v for k, v in rows[1].items() if k != "took_s"
    }


def test_a_tracker_begins_off_and_ends_near():
    cell = replace(LIDAR, target="envisat-bulky", task="tracking")
    tracked = population.run(cell, 7, 1)
    assert tracked["right"]
    assert 0.0 < tracked["attitude_deg"] < 1.0
    assert not tracked["ambiguous"]


@pytest.mark.parametrize("task", ["acquisition", "tracking"])
def test_a_frame_shows_the_target_of_its_cell(task):
    (cell,) = cells(sensor="pmd", task=task, target=("mockup",), filled=(0.6, 0.7), seed=7)
    found = [population.run(cell, 7, trial) for trial in range(2)]
    assert any(row["right"] for row in found)
    assert all(row["size_m"] == pytest.approx(1.2) for row in found)


def test_a_pose_is_right_below_both_limits():
    limits = Limits(3.0, 0.1)
    assert limits.are_met(2.9, 0.09)
    assert not limits.are_met(3.1, 0.09)
    assert not limits.are_met(2.9, 0.11)
    assert not limits.are_met(None, None)


def test_a_pose_is_coarse_where_its_covariance_does_not_promise_a_right_position():
    truth = make_pose(translation_m=(0.0, 0.0, 9.0))
    for sigma_m, coarse in ((0.3, True), (0.2, False), (math.nan, False)):
        covariance = np.diag([1e-6, 1e-6, sigma_m**2, 1e-6, 1e-6, 1e-6])
        found = Registration(Source.LIDAR, truth, Belief(BeliefLevel.ACCEPTED), covariance=covariance)
        assert counted(Acquisition(found))["coarse"] is coarse


def answer(level, best, *rivals):
    belief = Belief(level, "", {}, tuple(Rival("turned", rival, 0.0) for rival in rivals))
    return Acquisition(Registration(Source.LIDAR, best, belief))


def counted(found):
    """Return how an answer is counted for a body whose symmetries are none of these turns."""
    truth = make_pose(translation_m=(0.0, 0.0, 9.0))
    cell = replace(LIDAR, target="envisat-bulky")
    return population._acquired(cell, found, truth, cached_target(cell.target))


def test_the_command_prints_totals_beside_the_cells(tmp_path, capsys):
    options = {"target": "hexagonal-body", "trials": "1", "returns": "200,300", "task": "tracking"}
    assert campaign_command("population", options=options, jobs=1, out=tmp_path, as_json=True) == 0
    printed = json.loads(capsys.readouterr().out)
    (cell,), totals_ = printed["cells"], printed["totals"]
    assert (cell["body"], cell["trials"], cell["sensor"]) == ("hexagonal-body", 1, "lidar")
    assert set(cell) >= PROMISED
    assert totals_["all"]["trials"] == 1
    assert {"wilson_low", "wilson_high"} <= set(totals_["all"]["wrong_accepted"])
    assert totals_["returns_6_to_60"]["success"]["rate"] is None


def test_an_ambiguous_answer_is_a_success_only_with_the_truth_among_several_hypotheses():
    truth = make_pose(translation_m=(0.0, 0.0, 9.0))
    wrong, other = truth * make_pose(rotation=TURNED), truth * make_pose(rotation=TURNED.inv())
    with_truth, without = (
        counted(answer(BeliefLevel.DOUBTFUL, wrong, truth)),
        counted(answer(BeliefLevel.DOUBTFUL, wrong, other)),
    )
    assert (with_truth["ambiguous"], with_truth["truth_among"], with_truth["right"]) == (True, True, False)
    assert (without["ambiguous"], without["truth_among"]) == (True, False)
    alone = counted(answer(BeliefLevel.ACCEPTED, truth))
    assert (alone["accepted"], alone["right"], alone["truth_among"]) == (True, True, False)


def test_shares_are_over_frames_that_show_enough_and_the_others_are_counted_apart(rows):
    right = rows[0] | {"seen": True, "right": True, "accepted": True, "ambiguous": False, "returns": 100}
    right["coarse"] = True
    answers = [
        right,
        right | {"accepted": False},
        right | {"right": False, "attitude_deg": 30.0},
        right | {"right": False, "accepted": False, "ambiguous": True, "truth_among": True, "returns": 40},
        right | {"right": False, "accepted": False, "ambiguous": True, "truth_among": False},
        right | {"seen": False, "right": False},
    ]
    frame = pl.DataFrame(answers, schema=population.SCHEMA)
    s = summarise(LIDAR, frame)
    assert set(summarise(CAMERA, frame)) >= PROMISED
    assert (s["trials"], s["few_pixels"], s["ambiguous"]) == (5, 1, 2)
    assert s["success_rate"] == pytest.approx(3 / 5)
    assert (s["wrong_accepted"], s["right_rejected"]) == (1, 1)
    result = CellResult(LIDAR, frame, s)
    t = totals([result, result])
    assert t["all"]["success"]["count"] == 6
    assert t["all"]["success"]["wilson_low"] < 0.6 < t["all"]["success"]["wilson_high"]
    assert t["returns_60_or_more"]["trials"] == 8
    assert t["returns_6_to_60"]["trials"] == 2
    assert t["all"]["accepted_more_than_10_deg_off"]["count"] == 2
    assert (t["all"]["wrong_accepted_coarse"]["count"], t["all"]["coarse"]["count"]) == (2, 4)
    for section in sections([result, result]):
        for table in section.tables:
            assert all(len(row) == len(table.columns) for row in table.rows)


def test_the_figure_has_a_line_for_each_world_and_surroundings(rows):
    frame = pl.DataFrame([rows[0]], schema=population.SCHEMA)
    around = [("documented", "none"), ("noisy", "none"), ("documented", "laboratory")]
    cells_ = [replace(LIDAR, world=world, surroundings=things) for world, things in around]
    results = [CellResult(cell, frame, summarise(cell, frame)) for cell in cells_]
    (figure,) = sections(results)[1].figures
    assert [trace.name for trace in figure.data] == [", ".join(pair) for pair in around]
    other = replace(LIDAR, target="envisat-bulky")
    results = [CellResult(cell, frame, summarise(cell, frame)) for cell in (LIDAR, other)]
    assert [trace.name for trace in sections(results)[1].figures[0].data] == [LIDAR.target, other.target]


def test_a_matrix_has_each_target_with_itself_and_with_each_model(tmp_path, capsys):
    options = {"sensor": "lidar", "target": "hexagonal-body", "models": "@scale=1%,nothing", "trials": 1}
    run = {"jobs": 1, "out": tmp_path, "as_json": True}
    assert campaign_command("model-matrix", options=options, **run) == 2
    assert "--model: target 'nothing': is unknown" in capsys.readouterr().err
    assert campaign_command("model-matrix", options=options | {"models": "@scale=1%"}, **run) == 0
    told = json.loads(capsys.readouterr().out)["cells"]
    assert [(cell["model"], cell["task"]) for cell in told] == [
        (model, task) for model in ("", "hexagonal-body@scale=1%") for task in ("acquisition", "tracking")
    ]
    (page,) = tmp_path.glob("*/report.html")
    assert "hexagonal-body@scale=1%" in page.read_text()
