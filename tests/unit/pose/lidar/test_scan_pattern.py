"""What states the directions of a LIDAR's rays and the noise of its ranges."""

import numpy as np
import pytest

from rpod_pose.lidar.methods import known_pattern
from rpod_schemas.config.base import check
from rpod_schemas.config.estimator import LidarInput
from rpod_schemas.errors import ConfigurationError
from rpod_schemas.types import LidarInfo

ANGLES = np.linspace(-0.2, 0.2, 5)


def info(sigma_range_m: float) -> LidarInfo:
    return LidarInfo(azimuth_rad=ANGLES, elevation_rad=ANGLES, scan_time_s=0.1, sigma_range_m=sigma_range_m)


@pytest.mark.parametrize(
    ("stated_m", "configured_m", "counts_m"),
    [(0.02, 0.01, 0.02), (0.0, 0.01, 0.01), (0.02, None, 0.02), (0.0, None, 0.0)],
)
def test_the_configured_noise_counts_where_the_info_states_none(
    stated_m: float, configured_m: float | None, counts_m: float
) -> None:
    pattern = known_pattern(LidarInput(sigma_range_m=configured_m), info(stated_m))
    assert pattern is not None
    assert pattern.sigma_range_m == counts_m


def test_a_configured_pattern_counts_without_any_info() -> None:
    sensor = LidarInput(azimuth_rad=ANGLES, elevation_rad=ANGLES[:3], sigma_range_m=0.01)
    pattern = known_pattern(sensor, None)
    assert pattern is not None
    assert (str(pattern), pattern.sigma_range_m) == ("scan pattern of 3 x 5", 0.01)
    assert known_pattern(LidarInput(sigma_range_m=0.01), None) is None


def test_a_configured_pattern_that_does_not_fit_into_memory_is_refused() -> None:
    document = {"azimuth_rad": np.linspace(-3, 3, 65536), "elevation_rad": np.linspace(-1, 1, 65536)}
    with pytest.raises(ConfigurationError, match=r"is 4,294,967,296, needs 0 to 4,194,304"):
        check(LidarInput, document, source="run.yaml")
