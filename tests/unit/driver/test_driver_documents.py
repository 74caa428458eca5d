"""The example driver is short, and its configuration is one."""

from pathlib import Path

import pytest
from pydantic import ValidationError

import rpod_driver
from rpod_schemas.config.base import load
from rpod_schemas.config.driver import DriverConfig

FOLDER = Path(rpod_driver.__file__).parent


def test_a_camera_takes_about_thirty_lines():
    lines = (FOLDER / "examples" / "recorded_frames.py").read_text().splitlines()
    assert len([line for line in lines if line.strip()]) <= 36


def test_the_example_configuration_is_one():
    config = load(DriverConfig, FOLDER / "examples" / "recorded_frames.yaml")
    assert (config.kind, config.name) == ("pmd", "pmd")
    assert config.T_chaser_sensor.translation.tolist() == [0.0, 0.1, 0.0]


@pytest.mark.parametrize("missing", ["kind", "name"])
def test_a_driver_must_say_what_it_is(missing):
    fields = {"kind": "pmd", "name": "front"}
    del fields[missing]
    with pytest.raises(ValidationError, match=missing):
        DriverConfig.model_validate(fields)


def test_the_waits_between_two_attempts_must_be_in_order():
    with pytest.raises(ValidationError, match="shorter than retry_s"):
        DriverConfig(kind="pmd", name="pmd", retry_s=5.0, max_retry_s=1.0)
