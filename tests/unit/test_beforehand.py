"""A target that is too small for a scenario's sensors is told before the run."""

import pytest

from rpod.play.beforehand import too_fast, unseen
from rpod.scenarios import find
from rpod_schemas.config.base import check
from rpod_schemas.config.scenario import Scenario


def scenario(name: str, trajectory: dict[str, object]) -> Scenario:
    document = dict(find(name))
    document["motion"] = {**dict(find(name).motion), "trajectory": trajectory}
    return check(Scenario, document, source=name)


@pytest.mark.parametrize("name", ["mockup-approach", "envisat-station"])
def test_a_shipped_scenario_shows_its_target(name: str) -> None:
    assert list(unseen(find(name), 1.0)) == []


def test_millimetres_for_metres_are_told_with_the_fields() -> None:
    far = scenario("mockup-approach", {"kind": "approach", "start_m": [0, 0, 7000], "end_m": [0, 0, 2000]})
    (text,) = unseen(far, 0.9)
    assert text.startswith(
        "sensor 'pmd' cannot measure a pose: the target is 1.8 m wide, at least 2000 m away"
    )
    assert text.endswith("Are motion.trajectory.start_m and end_m in metres?")


def test_a_path_that_passes_near_by_is_as_near_as_its_nearest_place() -> None:
    past = scenario("mockup-approach", {"kind": "approach", "start_m": [-900, 0, 3], "end_m": [900, 0, 3]})
    assert list(unseen(past, 0.9)) == []


def test_a_lidar_too_far_away_is_told() -> None:
    orbit = {"kind": "station_keeping", "least_range_m": 20000.0, "greatest_range_m": 50000.0}
    (text,) = unseen(scenario("envisat-station", orbit), 15.0)
    assert "least_range_m in metres?" in text


def test_an_approach_that_is_faster_than_the_stated_prior_is_told_with_the_time_that_it_needs():
    shipped = find("mockup-handover")
    assert too_fast(shipped) == ""
    short = shipped.model_copy(update={"duration_s": 15.0})
    told = too_fast(short)
    assert "reaches 2.1 m/s in a run of 15 s" in told
    assert "initial_velocity_sigma_m_s of 0.3 expects at most 0.9 m/s" in told
    needed_s = float(told.split("play it in ")[1].split()[0])
    assert too_fast(shipped.model_copy(update={"duration_s": needed_s + 1.0})) == ""
    assert too_fast(find("envisat-station")) == ""
