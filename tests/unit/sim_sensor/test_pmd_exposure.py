"""The whole camera on plates of known shape, pose and reflectivity."""

import math
from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy import constants
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_geometry.rays import RayGrid, cast
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.pmd import PmdConfig
from rpod_schemas.poses import make_pose
from rpod_schemas.types import Camera
from rpod_sim_sensor.pmd import PmdEmulator, PmdExposure, PoseCountError
from rpod_target import Material, Target

CAMERA = Camera(width=44, height=36, fx=85.3, fy=86.4, cx=21.7, cy=17.4)
BARREL = CAMERA.model_copy(update={"distortion": np.array([-1.0, 0.3, 0.01, -0.02, 0.0])})
DARKNESS = np.zeros(3)
SUN_BEHIND = np.array([0.0, 0.0, -1361.0])
"""Behind the camera: it shines on what faces the camera."""


def plates(*parts: tuple[FloatArray, float], f0: float = 0.0, roughness: float = 1.0) -> Target:
    """Return a target of rectangles (two opposite corners, facing -z) with a diffuse albedo each."""
    quads = [
        [(x0, y0, z), (x0, y1, z), (x1, y1, z), (x0, y0, z), (x1, y1, z), (x1, y0, z)]
        for ((x0, y0, z), (x1, y1, _)), _ in parts
    ]
    triangles = np.array(quads, float).reshape(-1, 3, 3)
    return Target(
        name="plates",
        source="plates",
        digest="plates",
        triangles_m=triangles,
        normals=np.tile((0.0, 0.0, -1.0), (len(triangles), 1)),
        triangle_material=np.repeat(np.arange(len(parts)), 2).astype(np.int32),
        triangle_part=np.zeros(len(triangles), np.int32),
        materials=tuple(Material("plate", 0.5, albedo, f0, roughness) for _, albedo in parts),
        parts=("plate",),
        edges_m=np.empty((0, 2, 3)),
        edge_normals=np.empty((0, 2, 3)),
        model_points_m=np.empty((0, 3)),
        model_normals=np.empty((0, 3)),
        field=None,
        repairs=(),
        centre_of_mass_m=np.zeros(3),
        inertia_kg_m2=np.eye(3),
        radius_m=20.0,
        symmetries=(),
    )


def wall(albedo: float = 0.3, half_m: float = 8.0, **material: float) -> Target:
    return plates((np.array([(-half_m, -half_m, 0.0), (half_m, half_m, 0.0)]), albedo), **material)


def ideal(*, camera: Camera = CAMERA, **changes: object) -> PmdConfig:
    """Return a camera without stray light, wiggling, read noise, and almost without shot noise and steps.

    Charges are a thousand times the usual, so that their shot noise is a thirtieth relative to them.
    """
    many = 1e3
    document = {
        "camera": camera,
        "exposure": "fixed",
        "lamp": {"optical_power_W": 4.0 * many},
        "lens": {"stray_share": 0.0},
        "pixel": {
            "wiggling_share": 0.0,
            "read_noise_e": 0.0,
            "full_well_e": 150e3 * many,
            "electrons_per_count": 5.0 * many,
            "suppression_e_s": 6e8 * many,
        },
        "reconstruction": {"least_amplitude_e": 100.0 * many},
    }
    return PmdConfig.model_validate(document | changes)


def usual(**changes: object) -> PmdConfig:
    return PmdConfig.model_validate({"camera": CAMERA, "exposure": "fixed"} | changes)


def away(distance_m: float, *, turned_deg: Sequence[float] = (0.0, 0.0)) -> RigidTransform:
    turn = Rotation.from_euler("xy", turned_deg, degrees=True)
    return make_pose(rotation=turn, translation_m=(0.0, 0.0, distance_m))


def truth_m(target: Target, pose: RigidTransform, camera: Camera = CAMERA) -> FloatArray:
    grid = RayGrid.pinhole(camera)
    depth: FloatArray = cast(grid, target.triangles_m, pose).range_m * grid.components[2]
    return depth


@pytest.mark.parametrize("camera", [CAMERA, BARREL], ids=["pinhole", "distorted"])
@pytest.mark.parametrize("frequency_hz", [20.013e6, 30e6])
def test_without_noise_depth_is_the_truth(camera: Camera, frequency_hz: float) -> None:
    target, pose = wall(), away(3.0, turned_deg=(20.0, -35.0))
    config = ideal(camera=camera, modulation_frequency_hz=frequency_hz)
    exposure = PmdEmulator(config, target, seed=1).expose([pose] * 4, sun_W_m2=DARKNESS, frame=0)
    np.testing.assert_allclose(exposure.depth_m, truth_m(target, pose, camera), atol=2e-3)


def test_a_distorting_lens_moves_the_image_as_opencv_projects_it() -> None:
    target = plates((np.array([(0.3, 0.2, 0.0), (0.5, 0.4, 0.0)]), 0.3))
    pose = away(3.0)
    emulator = PmdEmulator(ideal(camera=BARREL, subsamples=8), target, seed=1)
    exposure = emulator.expose([pose] * 4, sun_W_m2=DARKNESS, frame=0)
    rows, columns = np.indices(exposure.amplitude.shape)
    weight = exposure.amplitude / exposure.amplitude.sum()
    seen = (columns * weight).sum(), (rows * weight).sum()
    grid = np.stack(np.meshgrid(np.linspace(0.3, 0.5, 21), np.linspace(0.2, 0.4, 21), [3.0]), -1).reshape(
        -1, 3
    )
    expected, _ = cv2.projectPoints(grid, np.zeros(3), np.zeros(3), BARREL.K, BARREL.distortion)
    np.testing.assert_allclose(seen, expected.mean(axis=(0, 1)), atol=0.1)
    straight, _ = cv2.projectPoints(grid, np.zeros(3), np.zeros(3), BARREL.K, np.zeros(5))
    assert np.abs(straight.mean(axis=(0, 1)) - seen).max() > 0.2


def test_amplitude_is_linear_in_albedo_and_falls_with_the_square_of_distance() -> None:
    def middle(albedo: float, distance_m: float) -> float:
        exposure = PmdEmulator(ideal(), wall(albedo), seed=1).expose(
            [away(distance_m)] * 4, sun_W_m2=DARKNESS, frame=0
        )
        return float(exposure.amplitude[15:20, 19:24].mean())

    assert middle(0.4, 4.0) == pytest.approx(2 * middle(0.2, 4.0), rel=2e-3)
    assert middle(0.4, 2.5) == pytest.approx(4 * middle(0.4, 5.0), rel=2e-3)


def test_amplitude_is_what_the_radiometry_gives_by_hand() -> None:
    config = usual(lens={"stray_share": 0.0}, pixel={"wiggling_share": 0.0})
    exposure = PmdEmulator(config, wall(0.3, roughness=1.0), seed=1).expose(
        [away(4.0)] * 4, sun_W_m2=DARKNESS, frame=0
    )
    irradiance = config.lamp_irradiance_W_m2 / 16.0
    specular = 0.0  # f0 = 0 along the normal
    electrons = config.electrons_per_radiance * irradiance * (0.3 / math.pi + specular)
    middle = exposure.amplitude[15:20, 19:24].mean() * config.pixel.electrons_per_count
    assert middle == pytest.approx(0.75 * electrons, rel=0.02)


def test_beyond_the_unambiguous_range_depth_wraps() -> None:
    config = ideal(reconstruction={"least_amplitude_e": 0.0, "asymmetry_limit": 1e9})
    exposure = PmdEmulator(config, wall(1.0, half_m=20.0), seed=1).expose(
        [away(9.0)] * 4, sun_W_m2=DARKNESS, frame=0
    )
    radial_m = exposure.depth_m[17, 22] / RayGrid.pinhole(CAMERA).components[2][17, 22]
    truth = 9.0 / RayGrid.pinhole(CAMERA).components[2][17, 22]
    assert radial_m == pytest.approx(truth - config.unambiguous_range_m, abs=5e-3)


@pytest.mark.parametrize("distance_m", [4.0, 6.0, 9.0, 13.0])
def test_two_frequencies_measure_where_one_wraps(distance_m: float) -> None:
    target, pose = wall(half_m=20.0, albedo=1.0), away(distance_m)
    config = ideal(profile="dual", reconstruction={"least_amplitude_e": 0.0})
    exposure = PmdEmulator(config, target, seed=1).expose([pose] * 8, sun_W_m2=DARKNESS, frame=0)
    assert exposure.samples.shape == (2, 36, 44, 4)
    np.testing.assert_allclose(exposure.depth_m, truth_m(target, pose), atol=1e-2)


def test_a_pixel_across_an_edge_sums_the_phasors_of_both_surfaces() -> None:
    left, right = (-8.0, -8.0, 0.0), (8.0, 8.0, 0.0)
    edge = (CAMERA.width // 2 - CAMERA.cx) / CAMERA.fx  # slope x/z of the middle of column 22
    near, far = 2.0, 3.5
    target = plates(
        (np.array([left, (edge * near, 8.0, 0.0)]), 0.2),
        (np.array([(-8.0, -8.0, far - near), (right[0], right[1], far - near)]), 0.5),
    )
    config = ideal()
    exposure = PmdEmulator(config, target, seed=1).expose([away(near)] * 4, sun_W_m2=DARKNESS, frame=0)
    cosine = RayGrid.pinhole(CAMERA).components[2]
    row, column = 17, 22
    wave = 4 * math.pi * config.modulation_frequency_hz / constants.c / cosine[row, column]
    phasor = 0.2 / near**2 * np.exp(1j * wave * near) + 0.5 / far**2 * np.exp(1j * wave * far)
    mixed_m = np.angle(phasor) % (2 * math.pi) / wave
    assert exposure.depth_m[row, column - 1] == pytest.approx(near, abs=2e-3)
    assert exposure.depth_m[row, column + 1] == pytest.approx(far, abs=2e-3)
    assert exposure.depth_m[row, column] == pytest.approx(mixed_m, abs=2e-2)
    assert near + 0.2 < exposure.depth_m[row, column] < far - 0.2


def test_one_ray_a_pixel_and_many_agree_within_a_surface() -> None:
    pose = away(3.0, turned_deg=(10.0, 25.0))
    one, four = (
        PmdEmulator(ideal(subsamples=count), wall(), seed=1).expose([pose] * 4, sun_W_m2=DARKNESS, frame=0)
        for count in (1, 4)
    )
    np.testing.assert_allclose(one.samples, four.samples.astype(int), rtol=0, atol=1)


def test_each_sample_sees_the_pose_of_its_own_sub_exposure() -> None:
    emulator = PmdEmulator(ideal(), wall(), seed=1)
    moving = [
        make_pose(
            rotation=Rotation.from_euler("y", 30 + 5 * time_s, degrees=True),
            translation_m=(0.0, 0.0, 3.0 - 2.0 * time_s),
        )
        for time_s in PmdConfig().pose_times_s()
    ]
    samples, *still = (
        emulator.expose(poses, sun_W_m2=DARKNESS, frame=0).samples.astype(int)
        for poses in (moving, *([pose] * 4 for pose in moving))
    )
    strength = np.abs(samples - 32768).max()
    for k in range(4):
        own, other = (np.abs(samples[..., k] - still[pose][..., k]).max() for pose in (k, (k + 2) % 4))
        assert own < 0.001 * strength
        assert other > 0.004 * strength


def test_an_approach_shifts_depth_by_less_than_its_path_during_the_exposure() -> None:
    times_s = PmdConfig().pose_times_s()
    still, moving = (
        PmdEmulator(ideal(), wall(), seed=1).expose(
            [away(3.0 - speed * t) for t in times_s], sun_W_m2=DARKNESS, frame=0
        )
        for speed in (0.0, 0.25)
    )
    shift_m = np.nanmean(moving.depth_m - still.depth_m)
    assert 1e-4 < abs(shift_m) < 0.25 * (times_s[-1] - times_s[0])


def test_a_frame_depends_on_its_number_alone() -> None:
    pose = away(4.0)

    def frame(number: int, *, seed: int = 1, name: str = "pmd", before: Sequence[int] = ()) -> np.ndarray:
        emulator = PmdEmulator(usual(name=name), wall(), seed=seed)
        for other in before:
            emulator.expose([away(2.0)] * 4, sun_W_m2=SUN_BEHIND, frame=other)
        return emulator.expose([pose] * 4, sun_W_m2=DARKNESS, frame=number).samples

    reference = frame(7)
    np.testing.assert_array_equal(reference, frame(7, before=(6, 8, 7, -1)))
    for other in (frame(8), frame(-7), frame(7, seed=2), frame(7, name="second")):
        assert (other != reference).mean() > 0.5


def test_earlier_frames_are_not_overwritten() -> None:
    emulator = PmdEmulator(usual(), wall(), seed=1)
    first = emulator.expose([away(4.0)] * 4, sun_W_m2=DARKNESS, frame=0)
    kept = [array.copy() for array in (first.depth_m, first.amplitude, first.samples)]
    emulator.expose([away(2.5)] * 4, sun_W_m2=SUN_BEHIND, frame=1)
    for array, copy in zip((first.depth_m, first.amplitude, first.samples), kept, strict=True):
        np.testing.assert_array_equal(array, copy)


@pytest.mark.parametrize("sun_W_m2", [DARKNESS, SUN_BEHIND], ids=["dark", "sun"])
def test_depth_noise_is_the_shot_and_read_noise_of_the_charge(sun_W_m2: FloatArray) -> None:
    config = usual(
        lens={"stray_share": 0.0}, pixel={"wiggling_share": 0.0}, reconstruction={"asymmetry_limit": 1e9}
    )
    emulator = PmdEmulator(config, wall(0.35), seed=3)
    depths_m = np.stack(
        [
            emulator.expose([away(4.0)] * 4, sun_W_m2=sun_W_m2, frame=number).depth_m[15:20, 19:24]
            for number in range(200)
        ]
    )
    per_radiance = config.electrons_per_radiance * 0.35 / math.pi
    signal_e = per_radiance * config.lamp_irradiance_W_m2 / 16.0
    background_e = per_radiance * (47.5 if sun_W_m2.any() else 0.0)
    rounding_e2 = 40.0**2 / 12
    variance_e2 = signal_e + background_e + 60.0**2 + rounding_e2
    sigma_rad = math.sqrt(variance_e2 / 2) / (0.75 * signal_e)
    sigma_m = sigma_rad * constants.c / (4 * math.pi * config.modulation_frequency_hz)
    assert depths_m.std(axis=0).mean() == pytest.approx(sigma_m, rel=0.05)
    assert depths_m.mean() == pytest.approx(4.0, abs=5 * sigma_m / math.sqrt(depths_m.size) + 1e-3)


def test_close_to_a_bright_surface_depth_is_lost_and_amplitude_stays() -> None:
    exposure = PmdEmulator(usual(), wall(0.6), seed=1).expose([away(1.2)] * 4, sun_W_m2=DARKNESS, frame=0)
    assert np.isnan(exposure.depth_m).all()
    assert exposure.amplitude.min() > 1000


def test_the_suns_glint_destroys_depth_and_amplitude_where_it_is_mirrored() -> None:
    mirror = wall(0.1, f0=0.85, roughness=0.2)
    pose = away(3.0, turned_deg=(0.0, 4.0))
    normal = pose.rotation.apply((0.0, 0.0, -1.0))
    view = np.array([0.0, 0.0, -1.0])
    sun = 2 * (normal @ view) * normal - view
    emulator = PmdEmulator(usual(), mirror, seed=1)
    in_sun = emulator.expose([pose] * 4, sun_W_m2=1361.0 * sun, frame=0)
    in_shade = emulator.expose([pose] * 4, sun_W_m2=DARKNESS, frame=0)
    assert np.isnan(in_sun.depth_m[17, 22])
    assert in_sun.amplitude[17, 22] == 0
    assert in_shade.amplitude[17, 22] > 500


def test_stray_light_gives_dark_pixels_a_share_of_the_mean() -> None:
    target = plates((np.array([(-8.0, -8.0, 0.0), (0.0, 8.0, 0.0)]), 0.3))
    config = ideal(lens={"stray_share": 0.01})
    exposure = PmdEmulator(config, target, seed=1).expose([away(3.0)] * 4, sun_W_m2=DARKNESS, frame=0)
    dark = exposure.amplitude[:, 30:].mean()
    assert dark == pytest.approx(0.01 * exposure.amplitude.mean(), rel=0.05)


def test_empty_space_has_no_depth() -> None:
    emulator = PmdEmulator(usual(), wall(half_m=1.0), seed=1)
    for pose in (away(-3.0), make_pose(translation_m=(50.0, 0.0, 3.0))):
        exposure = emulator.expose([pose] * 4, sun_W_m2=SUN_BEHIND, frame=0)
        assert np.isnan(exposure.depth_m).all()
        assert exposure.amplitude.max() < 10


def test_the_suns_light_from_behind_a_surface_does_not_reach_the_camera() -> None:
    emulator = PmdEmulator(usual(), wall(), seed=1)
    dark, lit_behind, lit = (
        emulator.expose([away(4.0)] * 4, sun_W_m2=sun, frame=5).samples
        for sun in (DARKNESS, -SUN_BEHIND, SUN_BEHIND)
    )
    np.testing.assert_array_equal(dark, lit_behind)
    assert (dark != lit).any()


def test_an_open_surface_is_seen_from_its_inside_too() -> None:
    emulator = PmdEmulator(ideal(), wall(), seed=1)
    front, back = (
        emulator.expose([away(3.0, turned_deg=(0.0, turn))] * 4, sun_W_m2=DARKNESS, frame=0)
        for turn in (0.0, 180.0)
    )
    np.testing.assert_allclose(front.depth_m, back.depth_m, atol=1e-3)


def test_a_finer_mesh_of_the_same_surface_gives_the_same_frame() -> None:
    coarse = wall()
    v0, v1, v2 = coarse.triangles_m.transpose(1, 0, 2)
    m01, m12, m20 = 0.5 * (v0 + v1), 0.5 * (v1 + v2), 0.5 * (v2 + v0)
    parts = [(v0, m01, m20), (m01, v1, m12), (m20, m12, v2), (m01, m12, m20)]
    fine = replace(
        coarse,
        triangles_m=np.concatenate([np.stack(part, axis=1) for part in parts]),
        normals=np.tile(coarse.normals, (4, 1)),
        triangle_material=np.tile(coarse.triangle_material, 4),
    )
    poses = [away(3.0 - 0.01 * k, turned_deg=(10.0, 25.0 + k)) for k in range(4)]
    one, other = (
        PmdEmulator(usual(), target, seed=1).expose(poses, sun_W_m2=SUN_BEHIND, frame=2)
        for target in (coarse, fine)
    )
    np.testing.assert_allclose(one.samples, other.samples.astype(int), rtol=0, atol=1)


def test_a_frame_is_written_into_the_callers_arrays() -> None:
    emulator = PmdEmulator(usual(), wall(), seed=1)
    new = emulator.expose([away(3.0)] * 4, sun_W_m2=SUN_BEHIND, frame=4)
    out = PmdExposure.of(usual())
    filled = emulator.expose([away(3.0)] * 4, sun_W_m2=SUN_BEHIND, frame=4, out=out)
    assert filled.samples is out.samples
    assert filled.depth_m is out.depth_m
    np.testing.assert_array_equal(filled.samples, new.samples)
    np.testing.assert_array_equal(filled.depth_m, new.depth_m)
    np.testing.assert_array_equal(filled.images.lost, new.images.lost)


def test_an_exposure_needs_a_pose_for_each_sub_exposure() -> None:
    with pytest.raises(PoseCountError, match="got 3 poses, but an exposure needs 4"):
        PmdEmulator(usual(), wall(), seed=1).expose([away(3.0)] * 3, sun_W_m2=DARKNESS, frame=0)
