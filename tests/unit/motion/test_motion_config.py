"""What a motion's configuration accepts, and how it says what is wrong."""

from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from rpod.scenarios import find
from rpod_schemas.config.base import check
from rpod_schemas.config.emulator import MotionServiceConfig
from rpod_schemas.config.motion import (
    ApproachConfig,
    MotionConfig,
    StationKeepingConfig,
    TumbleConfig,
)
from rpod_schemas.config.scenario import Scenario
from rpod_schemas.errors import ConfigurationError


def test_a_document_selects_trajectory_and_attitude_by_kind() -> None:
    document = {
        "trajectory": {"kind": "station_keeping", "phase_deg": 30},
        "attitude": {
            "kind": "tumble",
            "rate_deg_s": [1, 2, 3],
            "R_chaser_target": {"euler_321_deg": [0, 90, 0]},
        },
        "sun": {"direction": [0, 0, -1]},
    }
    config = check(MotionConfig, document, source="scenario")
    assert isinstance(config.trajectory, StationKeepingConfig)
    assert isinstance(config.attitude, TumbleConfig)
    np.testing.assert_allclose(config.attitude.R_chaser_target.apply([1, 0, 0]), [0, 0, -1], atol=1e-15)


def test_the_default_is_a_frontal_approach_in_darkness() -> None:
    config = MotionConfig()
    assert isinstance(config.trajectory, ApproachConfig)
    assert config.sun is None
    np.testing.assert_allclose(config.attitude.R_chaser_target.as_matrix()[:, 0], [0, 0, -1], atol=1e-15)


def test_what_was_resolved_can_be_read_again() -> None:
    config = MotionConfig()
    again = MotionConfig.model_validate_json(config.model_dump_json())
    assert again.model_dump() == config.model_dump()


@pytest.mark.parametrize(
    ("document", "field", "reason"),
    [
        (
            {"trajectory": {"kind": "approach", "start_m": [0, 0, 2]}},
            "trajectory.approach",
            "start_m equals end_m",
        ),
        (
            {"trajectory": {"kind": "approach", "end_m": [0, 0, -2]}},
            "trajectory.approach",
            "range along the bore",
        ),
        ({"trajectory": {"kind": "approach", "ramp_share": 0.6}}, "trajectory.approach.ramp_share", "0.5"),
        (
            {"trajectory": {"kind": "station_keeping", "least_range_m": -20}},
            "trajectory.station_keeping.least_range_m",
            "greater than 0",
        ),
        (
            {"trajectory": {"kind": "station_keeping", "least_range_m": 30}},
            "trajectory.station_keeping",
            "more than twice least_range_m",
        ),
        (
            {"trajectory": {"kind": "station_keeping", "semi_major_axis_m": 790e3}},
            "trajectory.station_keeping.semi_major_axis_m",
            "greater than 6400000",
        ),
        ({"trajectory": {"kind": "orbit"}}, "trajectory", "orbit"),
        ({"attitude": {"kind": "spin", "axis": [0, 0, 0]}}, "attitude.spin.axis", "no direction"),
        ({"attitude": {"kind": "spin", "rate_deg_s": float("nan")}}, "attitude.spin.rate_deg_s", "finite"),
        ({"attitude": {"kind": "tumble"}}, "attitude.tumble.rate_deg_s", "is missing"),
        (
            {"attitude": {"kind": "fixed", "R_chaser_target": {"translation_m": [0, 0, 0]}}},
            "attitude.fixed.R_chaser_target",
            "needs quaternion_xyzw, or euler_321_deg",
        ),
        ({"sun": {"direction": [0, 0, 0]}}, "sun.direction", "no direction"),
        (
            {"sun": {"direction": [0, 0, 1], "irradiance_W_m2": -1}},
            "sun.irradiance_W_m2",
            "greater than or equal",
        ),
    ],
)
def test_a_wrong_field_is_named_with_the_reason(document: dict[str, Any], field: str, reason: str) -> None:
    with pytest.raises(ConfigurationError, match=reason) as raised:
        check(MotionConfig, document, source="scenario")
    assert raised.value.field == field


@pytest.mark.parametrize(
    ("readings", "field"),
    [
        ({"imu": {"rate_hz": 100}}, "motion.imu.rate_hz is 100"),
        ({"imu": {"rate_hz": 400}}, "motion.imu.rate_hz is 400"),
        ({"command": {"rate_hz": 100}}, "motion.command.rate_hz is 100"),
        ({"bodies": {"forearm": {"rate_hz": 30}}}, "motion.bodies.forearm.rate_hz is 30"),
    ],
)
def test_readings_whose_rate_does_not_divide_that_of_the_truth_are_refused(readings, field):
    motion = MotionConfig.model_validate(readings)
    with pytest.raises(ValueError, match=field):
        motion.check_rates(250.0)
    MotionServiceConfig(target="mockup", motion=motion, duration_s=1.0, rate_hz=1200.0)
    with pytest.raises(ValidationError, match=f"{field}, needs a divisor of the truth's rate, 250 Hz"):
        MotionServiceConfig(target="mockup", motion=motion, duration_s=1.0)
    with pytest.raises(ValidationError, match=field):
        Scenario.model_validate(dict(find("mockup-tumbling")) | {"motion": motion})
