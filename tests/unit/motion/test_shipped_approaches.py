"""The shipped approaches keep clear of their targets."""

from importlib.resources import files

import numpy as np
import pytest
import trimesh
import yaml

from rpod_motion import build_motion
from rpod_schemas.config.scenario import Scenario
from rpod_target import load_target


def scenario(name: str) -> Scenario:
    return Scenario.model_validate(yaml.safe_load((files("rpod") / "scenarios" / f"{name}.yaml").read_text()))


@pytest.mark.parametrize(
    ("name", "clearance_m", "end_m"), [("envisat-capture", 1.0, 2.0), ("mockup-handover", 0.5, 0.6)]
)
def test_chaser_and_sensors_keep_clear_of_the_target_all_the_way(name, clearance_m, end_m):
    made = scenario(name)
    target = load_target(made.target)
    motion = build_motion(
        made.motion,
        centre_of_mass_m=target.centre_of_mass_m,
        inertia_kg_m2=target.inertia_kg_m2,
        duration_s=made.duration_s,
    )
    poses = [motion.state(time_s).T_chaser_target for time_s in np.linspace(0.0, made.duration_s, 121)]
    origins_m = [np.zeros(3), *(sensor.T_chaser_sensor.translation for sensor in made.sensors)]
    places_m = np.array([pose.inv().apply(origin) for pose in poses for origin in origins_m])
    body = trimesh.Trimesh(*_welded(target.triangles_m), process=False)
    near = places_m[np.linalg.norm(places_m, axis=1) < target.radius_m + 2.0]
    _, distance_m, _ = trimesh.proximity.closest_point_naive(body, near)
    assert distance_m.min() >= clearance_m
    assert distance_m[-1] < end_m + 0.5, "the approach ends where it should"


def _welded(triangles_m):
    return triangles_m.reshape(-1, 3), np.arange(3 * len(triangles_m)).reshape(-1, 3)


def test_the_capture_ends_two_metres_before_the_launch_adapter_of_a_target_that_turns_3_5_deg_per_second():
    made = scenario("envisat-capture")
    target = load_target(made.target)
    adapter = target.triangles_m[target.triangle_part == list(target.parts).index("launch-adapter")]
    end = made.motion.trajectory.end_m
    assert end[2] + adapter[..., 0].min() == pytest.approx(2.0, abs=0.05)
    assert np.linalg.norm(made.motion.attitude.rate_deg_s) == pytest.approx(3.5, abs=0.05)
