"""The exposure that shortens itself where the target is close and bright."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from rpod_schemas.config.motion import FACING
from rpod_schemas.config.pmd import PmdConfig
from rpod_schemas.poses import make_pose
from rpod_sim_sensor.pmd import PmdEmulator, PmdExposure
from rpod_sim_sensor.pmd.metering import exposure_share
from rpod_sim_sensor.pmd.pixel import Electronics
from rpod_target import load_target

AUTOMATIC, FIXED = PmdConfig(exposure="automatic"), PmdConfig(exposure="fixed")
CHIP = Electronics.of(AUTOMATIC)
MOST_E = AUTOMATIC.automatic_exposure.full_well_share * CHIP.full_well_e
SUN_W_M2 = np.array([700.0, 0.0, -700.0])


def facing(range_m: float) -> RigidTransform:
    return make_pose(rotation=FACING, translation_m=(0.0, 0.0, range_m))


def exposed(config: PmdConfig, range_m: float, *frames: int) -> PmdExposure:
    emulator = PmdEmulator(config, load_target("mockup"), seed=1)
    poses = [facing(range_m)] * config.sub_exposures
    *_, last = [emulator.expose(poses, sun_W_m2=SUN_W_M2, frame=frame) for frame in frames]
    return last


def share_of(*differences_e: float) -> float:
    """Return the share of time for pixels whose taps differ by so much, as many of each."""
    strongest = np.repeat(differences_e, 400).reshape(-1, 20) / CHIP.contrast
    modulated_e = np.stack([strongest, -strongest, 0 * strongest, 0 * strongest]).astype(np.float32)
    return exposure_share(modulated_e, strongest.astype(np.float32), AUTOMATIC, CHIP)


def test_what_fits_the_taps_has_the_full_time() -> None:
    assert share_of(0.0, 0.5 * MOST_E, 0.99 * MOST_E) == 1.0


@pytest.mark.parametrize("factor", [1.1, 2.5, 30.0])
def test_what_is_too_bright_fits_the_taps_within_half_a_stop(factor: float) -> None:
    share = share_of(factor * MOST_E)
    assert 2**-0.5 < factor * share <= 1.0


def test_a_few_glints_do_not_darken_the_others() -> None:
    usual = [0.3 * MOST_E] * 25
    assert share_of(*usual, 40 * MOST_E) == 1.0
    assert share_of(*usual[:10], 2 * MOST_E) < 1.0


def test_darkness_has_the_full_time() -> None:
    assert share_of(0.0) == 1.0


def test_what_no_time_can_save_does_not_count() -> None:
    assert share_of(0.5 * MOST_E, 1e9 * MOST_E) == 1.0


@pytest.mark.parametrize("range_m", [7.0, 4.0, 2.5])
def test_frames_from_afar_are_those_of_the_fixed_exposure(range_m: float) -> None:
    automatic, fixed = exposed(AUTOMATIC, range_m, 3), exposed(FIXED, range_m, 3)
    np.testing.assert_array_equal(automatic.samples, fixed.samples)
    assert automatic.integration_time_s == AUTOMATIC.integration_time_s


def test_a_close_target_keeps_its_depth() -> None:
    automatic, fixed = exposed(AUTOMATIC, 1.0, 3), exposed(FIXED, 1.0, 3)
    assert np.isfinite(fixed.depth_m).mean() < 0.3
    assert np.isfinite(automatic.depth_m).mean() > 0.85
    assert automatic.integration_time_s < 0.1 * fixed.integration_time_s


def test_the_exposure_is_that_of_the_frame_whatever_came_before() -> None:
    alone, after_others = exposed(AUTOMATIC, 1.5, 7), exposed(AUTOMATIC, 1.5, 1, 2, 7)
    np.testing.assert_array_equal(alone.samples, after_others.samples)
    assert alone.integration_time_s == after_others.integration_time_s
