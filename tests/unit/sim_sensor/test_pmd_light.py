"""The light on one pixel that looks straight at a plate: figures by hand."""

import math

import numpy as np
import pytest
from scipy import constants
from scipy.spatial.transform import RigidTransform

from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.pmd import PmdConfig
from rpod_sim_sensor.pmd.light import SUN_RADIUS_RAD, THETA_RAD, Fragments, collect, lights
from rpod_sim_sensor.pmd.scene import Scene
from rpod_sim_sensor.surroundings import scenery
from rpod_target import Material, load_target

CONFIG = PmdConfig()
ALONG_Z = np.array([[[0.0]], [[0.0]], [[1.0]]], np.float32)
DARKNESS = np.zeros(3)
NO_MOUNT = RigidTransform.identity()
SUN_BEHIND = np.array([0.0, 0.0, -1361.0])


class Plate:
    """What ``Scene`` reads of a target: one triangle that faces the camera."""

    def __init__(self, **material: float) -> None:
        parameters = {"reflectivity": 0.5, "diffuse": 0.0, "f0": 0.0, "roughness": 0.5} | material
        self.materials = (Material(name="plate", **parameters),)
        self.triangle_material = np.zeros(1, np.int32)
        self.triangles_m = np.array([[[-1.0, -1.0, 0.0], [0.0, 2.0, 0.0], [1.0, -1.0, 0.0]]])
        self.normals = np.array([[0.0, 0.0, -1.0]])


def light_of(
    plate: Plate, distance_m: float, *, sun_W_m2: FloatArray = DARKNESS, config: PmdConfig = CONFIG
) -> tuple[FloatArray, float]:
    """Return the modulated electrons of the four samples, and all electrons."""
    pose = RigidTransform.from_translation((0.0, 0.0, distance_m))
    modulated_e, charge_e = np.empty((4, 1, 1), np.float32), np.empty((1, 1), np.float32)
    collect(
        np.zeros((1, 1), np.int32),
        ALONG_Z,
        ALONG_Z,
        Scene(scenery(plate, (), NO_MOUNT), 4).placed(pose, [pose] * 4),  # type: ignore[arg-type]
        lights(config, sun_W_m2),
        fragments=Fragments.of(1, 4),
        modulated_e=modulated_e,
        charge_e=charge_e,
    )
    return modulated_e[:, 0, 0].astype(float), float(charge_e[0, 0])


def test_samples_are_the_correlation_with_its_third_harmonic() -> None:
    modulated_e, charge_e = light_of(Plate(diffuse=0.35), 4.2)
    phi = 4 * math.pi * CONFIG.modulation_frequency_hz * 4.2 / constants.c
    x = phi - np.array(THETA_RAD)
    np.testing.assert_allclose(modulated_e / charge_e, np.cos(x) + 0.03 * np.cos(3 * x), rtol=1e-5)


def test_electrons_follow_lamberts_law_and_the_square_of_distance() -> None:
    _, charge_e = light_of(Plate(diffuse=0.35), 4.0)
    irradiance = CONFIG.lamp_irradiance_W_m2 / 16
    assert charge_e == pytest.approx(CONFIG.electrons_per_radiance * irradiance * 0.35 / math.pi, rel=1e-5)


def test_the_sun_adds_charge_and_no_modulation() -> None:
    dark_modulated_e, dark_e = light_of(Plate(diffuse=0.35), 4.0)
    modulated_e, charge_e = light_of(Plate(diffuse=0.35), 4.0, sun_W_m2=SUN_BEHIND)
    np.testing.assert_array_equal(modulated_e, dark_modulated_e)
    assert charge_e - dark_e == pytest.approx(CONFIG.electrons_per_radiance * 47.5 * 0.35 / math.pi, rel=1e-4)


@pytest.mark.parametrize("roughness", [0.0, 0.04, 0.3], ids=["mirror", "foil", "paint"])
def test_a_glint_is_spread_by_the_material_and_by_the_size_of_its_source(roughness: float) -> None:
    plate = Plate(f0=0.8, roughness=roughness)
    _, lamp_e = light_of(plate, 4.0)
    lamp_alpha2 = roughness**4 + (0.5 * CONFIG.lamp.radius_m / 4.0) ** 2
    lamp = CONFIG.electrons_per_radiance * CONFIG.lamp_irradiance_W_m2 / 16
    assert lamp_e == pytest.approx(lamp * 0.8 / (4 * math.pi * lamp_alpha2), rel=1e-5)

    _, both_e = light_of(plate, 4.0, sun_W_m2=SUN_BEHIND)
    sun_alpha2 = roughness**4 + (0.5 * SUN_RADIUS_RAD) ** 2
    sun = CONFIG.electrons_per_radiance * 47.5
    assert both_e - lamp_e == pytest.approx(sun * 0.8 / (4 * math.pi * sun_alpha2), rel=1e-4)


def test_a_pixel_that_meets_nothing_collects_nothing() -> None:
    modulated_e, charge_e = np.ones((4, 1, 1), np.float32), np.ones((1, 1), np.float32)
    scene = Scene(scenery(load_target("mockup"), (), NO_MOUNT), 4)
    pose = RigidTransform.from_translation((0.0, 0.0, 5.0))
    nothing = np.full((2, 2), -1, np.int32)
    rays = np.tile(ALONG_Z, (1, 2, 2))
    surfaces, lit = scene.placed(pose, [pose] * 4), lights(CONFIG, SUN_BEHIND)
    collect(
        nothing,
        rays,
        ALONG_Z,
        surfaces,
        lit,
        fragments=Fragments.of(4, 4),
        modulated_e=modulated_e,
        charge_e=charge_e,
    )
    assert not modulated_e.any()
    assert not charge_e.any()
