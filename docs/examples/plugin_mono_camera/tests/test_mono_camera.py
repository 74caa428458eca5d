"""The camera by itself: run where the package is installed (``PYTHONPATH``)."""

import numpy as np
import pytest
from rpod_mono_camera.config import EdgeTrackingConfig, MonoConfig, MonoPixelConfig
from rpod_mono_camera.emulator import MonoEmulator
from rpod_mono_camera.frame import MonoFrame
from rpod_mono_camera.methods import EdgeTracker
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_schemas.sensors import method, methods, sensor_kind
from rpod_schemas.types import BeliefLevel
from rpod_target import load_target

SUN_W_M2 = 1361.0 * np.array([0.5, -0.6, -0.62]) / np.linalg.norm([0.5, -0.6, -0.62])
POSE = RigidTransform.from_components(
    [0.1, 0.05, 4.0], Rotation.from_euler("ZYX", [10.0, 60.0, 5.0], degrees=True)
)


@pytest.fixture(scope="module")
def emulator() -> MonoEmulator:
    return MonoEmulator(MonoConfig(), load_target("mockup"), seed=7)


def seen(image: np.ndarray) -> MonoFrame:
    return MonoFrame(stamp_ns=0, frame_id="mono_optical", image=image, camera=MonoConfig().camera)


def test_the_package_brings_its_kind_and_its_methods():
    assert sensor_kind("mono").emulated is MonoConfig
    assert [each.name for each in methods("mono")] == ["edges", "near_prediction"]
    assert method("mono", "edges").config is EdgeTrackingConfig


def test_a_frame_is_the_same_whenever_it_is_asked_for(emulator: MonoEmulator):
    first = emulator.expose(POSE, sun_W_m2=SUN_W_M2, frame=3)
    other = emulator.expose(POSE, sun_W_m2=SUN_W_M2, frame=4)
    assert np.array_equal(first, emulator.expose(POSE, sun_W_m2=SUN_W_M2, frame=3))
    assert not np.array_equal(first, other)


def test_noise_is_that_of_photons_and_of_reading():
    pixel = MonoPixelConfig(nonuniformity_share=0.0)
    config = MonoConfig(exposure="fixed", exposure_s=1e-4, pixel=pixel)
    camera = MonoEmulator(config, load_target("mockup"), seed=1)
    images = np.stack([camera.expose(POSE, sun_W_m2=SUN_W_M2, frame=n).astype(float) for n in range(40)])
    per_count = pixel.full_well_e / (1.0 - pixel.black_share) / 4095.0
    mean_e = (images.mean(axis=0) - 4095.0 * pixel.black_share) * per_count
    variance_e2 = images.var(axis=0, ddof=1) * per_count**2
    lit = (mean_e > 500.0) & (mean_e < 6000.0)
    expected_e2 = mean_e[lit] + pixel.read_noise_e**2 + per_count**2 / 12.0
    assert lit.sum() > 2000
    assert (variance_e2[lit] / expected_e2).mean() == pytest.approx(1.0, abs=0.02)


def test_the_tracker_finds_the_pose_from_beside_it(emulator: MonoEmulator):
    tracker = EdgeTracker(EdgeTrackingConfig(), load_target("mockup"))
    image = emulator.expose(POSE, sun_W_m2=SUN_W_M2, frame=1)
    beside = POSE * RigidTransform.from_components(
        [0.01, -0.01, 0.02], Rotation.from_rotvec([0.01, 0.02, -0.01])
    )
    found = tracker.track(seen(image), beside)
    assert found.belief.level is BeliefLevel.ACCEPTED
    error = POSE.inv() * found.T_sensor_target
    assert np.rad2deg(error.rotation.magnitude()) < 0.3
    assert np.abs(error.translation).max() < 0.02


def test_the_tracker_does_not_believe_a_mirrored_image(emulator: MonoEmulator):
    tracker = EdgeTracker(EdgeTrackingConfig(), load_target("mockup"))
    image = emulator.expose(POSE, sun_W_m2=SUN_W_M2, frame=1)[:, ::-1].copy()
    assert tracker.track(seen(image), POSE).belief.level is not BeliefLevel.ACCEPTED


def test_a_dark_image_gives_no_pose():
    tracker = EdgeTracker(EdgeTrackingConfig(), load_target("mockup"))
    found = tracker.track(seen(np.zeros((480, 640), np.uint16)), POSE)
    assert found.T_sensor_target is None
    assert "edge samples" in found.belief.reason


def test_an_image_of_another_size_or_type_is_no_frame():
    with pytest.raises(ValueError, match="camera_info says"):
        seen(np.zeros((10, 10), np.uint8))
    with pytest.raises(ValueError, match="needs uint8 or uint16"):
        seen(np.zeros((480, 640), np.float32))
