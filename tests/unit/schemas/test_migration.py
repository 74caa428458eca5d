import pytest

from rpod_schemas.config.estimator import EstimatorConfig
from rpod_schemas.config.migration import check_logged
from rpod_schemas.errors import ConfigurationError

OF_AN_EARLIER_VERSION = {
    "target": "mockup",
    "sensors": [
        {"kind": "pmd", "verification": {"max_cost_m2": 0.003}, "tracking": {"kind": "joint", "gone": 1}},
        {"kind": "lidar", "verification": {"max_cost_m2": 0.003}},
    ],
    "verbosity": 3,
}


def test_fields_that_are_gone_are_left_out_and_named_with_their_place() -> None:
    config, unknown = check_logged(EstimatorConfig, OF_AN_EARLIER_VERSION, source="run.mcap")
    assert [sensor.kind for sensor in config.sensors] == ["pmd", "lidar"]
    assert sorted(unknown) == [
        "sensors.0.tracking.gone",
        "sensors.0.verification",
        "sensors.1.verification",
        "verbosity",
    ]


def test_a_value_that_is_wrong_today_is_an_error_that_names_the_field() -> None:
    with pytest.raises(ConfigurationError, match=r"run\.mcap.*max_age_s"):
        check_logged(EstimatorConfig, {**OF_AN_EARLIER_VERSION, "max_age_s": -1.0}, source="run.mcap")


def test_the_document_itself_stays_as_it_is() -> None:
    check_logged(EstimatorConfig, OF_AN_EARLIER_VERSION, source="run.mcap")
    assert "verbosity" in OF_AN_EARLIER_VERSION
