"""Worlds change what the emulator makes of the light, and nothing of what the sensor says of itself."""

from typing import get_args

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.emulator import WorldName
from rpod_schemas.config.lidar import LidarConfig, LidarNoiseConfig
from rpod_schemas.config.pmd import PmdConfig
from rpod_schemas.poses import make_pose
from rpod_sim_sensor.lidar import LidarEmulator, LidarReturns
from rpod_sim_sensor.pmd import PmdEmulator, PmdExposure
from rpod_sim_sensor.worlds import WORLDS, UnknownWorldError, world_of
from rpod_target import load_target

LIDAR, CAMERA = LidarConfig(), PmdConfig(subsamples=1)
TURN = Rotation.from_euler("ZYX", (20.0, -60.0, 10.0), degrees=True)
OBLIQUE = make_pose(rotation=TURN, translation_m=(0.0, 0.0, 4.0))
FAR = make_pose(rotation=TURN, translation_m=(0.0, 0.0, 80.0))
DARKNESS = np.zeros(3)


def scanned(world: str, frame: int = 0, config: LidarConfig = LIDAR) -> LidarReturns:
    emulator = LidarEmulator(config, load_target("envisat-bulky"), seed=3, world=world_of(world))
    return emulator.scan([FAR], frame=frame)


def exposed(world: str) -> PmdExposure:
    emulator = PmdEmulator(CAMERA, load_target("mockup"), seed=3, world=world_of(world))
    return emulator.expose([OBLIQUE] * 4, sun_W_m2=DARKNESS, frame=0)


def ranges(returns: LidarReturns) -> FloatArray:
    return np.linalg.norm(returns.points_m, axis=-1)


def test_a_scenario_can_ask_for_every_world_by_its_name() -> None:
    assert tuple(WORLDS) == get_args(WorldName)


def test_half_of_the_worlds_are_held_out() -> None:
    assert sum(world.held_out for world in WORLDS.values()) * 2 == len(WORLDS)


def test_an_unknown_world_is_named() -> None:
    with pytest.raises(UnknownWorldError, match="'mars'; it must be one of documented"):
        world_of("mars")


@pytest.mark.parametrize(
    "world", ["lambertian", "specular", "noisy", "multipath", "stray-light", "exchanged"]
)
def test_a_camera_sees_another_world(world: str) -> None:
    ours, theirs = exposed("documented"), exposed(world)
    assert not np.array_equal(ours.amplitude, theirs.amplitude)


@pytest.mark.parametrize(
    "world", ["faint", "keen", "outliers", "specular", "multipath", "noisy", "stray-light"]
)
def test_a_lidar_sees_another_world(world: str) -> None:
    assert not np.array_equal(scanned("documented").points_m, scanned(world).points_m, equal_nan=True)


@pytest.mark.parametrize("world", ["lambertian", "faint", "keen", "outliers"])
def test_a_world_of_the_lidar_alone_leaves_the_camera_as_it_is(world: str) -> None:
    same = world != "lambertian"
    assert np.array_equal(exposed("documented").samples, exposed(world).samples) == same


def test_a_faint_laser_returns_less_and_a_keen_one_more() -> None:
    counts = [np.isfinite(ranges(scanned(world))).sum() for world in ("faint", "documented", "keen")]
    assert counts[0] < counts[1] < counts[2]


def test_noise_is_a_fifth_larger_and_its_tails_are_heavy() -> None:
    noise, generator = world_of("noisy").noise, np.random.default_rng(1)
    errors = noise.draw(generator, 400_000)
    assert np.std(errors) == pytest.approx(1.2, rel=0.03)
    assert np.mean(np.abs(errors) > 4.0 * 1.2) > 20.0 * 6.3e-5  # 6.3e-5 of normal errors


def test_light_that_was_reflected_twice_makes_ranges_longer() -> None:
    difference = exposed("multipath").depth_m - exposed("documented").depth_m
    assert np.nanmedian(difference) > 0.002


def test_glare_lights_the_sky_beside_the_target() -> None:
    dark = exposed("documented").amplitude == 0
    assert exposed("stray-light").amplitude[dark].mean() > exposed("documented").amplitude[dark].mean() + 1.0


def test_returns_at_edges_lie_between_two_surfaces() -> None:
    exact = LIDAR.model_copy(
        update={"noise": LidarNoiseConfig(sigma_range_m=0.0, sigma_pointing_rad=0.0, outlier_share=0.0)}
    )
    found = [
        np.stack([ranges(scanned(world, frame, exact)) for frame in range(8)])
        for world in ("documented", "multipath")
    ]
    ours, theirs = found
    both = np.isfinite(ours) & np.isfinite(theirs)
    assert 0.04 < (np.abs(ours - theirs)[both] > 0.02).mean() < 0.4
    assert np.count_nonzero(np.isfinite(theirs) & ~np.isfinite(ours)) > 0  # the beam's rim meets the target


def test_stray_light_returns_ranges_where_nothing_is() -> None:
    new = np.isfinite(ranges(scanned("stray-light"))) & ~np.isfinite(ranges(scanned("documented")))
    assert 0 < new.sum() < 30


def test_materials_move_to_other_parts_and_the_shape_stays() -> None:
    target = load_target("mockup")
    moved = world_of("exchanged").target(target)
    assert np.array_equal(moved.triangles_m, target.triangles_m)
    assert (moved.triangle_material != target.triangle_material).all()


def test_a_lambertian_world_has_no_lobe_and_a_specular_one_no_brighter_surface() -> None:
    target = load_target("mockup")
    assert all(material.f0 == 0.0 for material in world_of("lambertian").target(target).materials)
    for before, after in zip(target.materials, world_of("specular").target(target).materials, strict=True):
        assert after.diffuse < before.diffuse
        assert after.f0 > before.f0


def test_a_sensor_says_the_same_of_itself_in_every_world() -> None:
    info = LIDAR.info()
    scanned("noisy")
    assert LIDAR.info().sigma_range_m == info.sigma_range_m == LIDAR.noise.sigma_range_m
