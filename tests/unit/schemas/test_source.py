"""The field ``source`` of a sensor, as a person who does not know its rules may write it."""

import pytest

from rpod_schemas.config.base import check
from rpod_schemas.config.estimator import EstimatorConfig
from rpod_schemas.errors import ConfigurationError

GIVEN = {"depth": "depth/image_raw", "camera_info": "depth/camera_info"}


def told(source):
    """Return the error that a source ends in."""
    document = {"target": "mockup", "sensors": [{"kind": "pmd", "source": source}]}
    with pytest.raises(ConfigurationError) as error:
        check(EstimatorConfig, document, source="lab.yaml")
    return str(error.value)


@pytest.mark.parametrize("name", ["", "/", "a b", "a/", "a//b", "*", "a/$*", "a#", "a?", "~/depth"])
def test_a_topic_that_no_key_can_have_is_told(name):
    text = told({"topics": GIVEN | {"depth": name}})
    assert text.startswith(f"lab.yaml: sensors.0.source.topics.depth: is {name!r}; needs names of letters")


@pytest.mark.parametrize("preset", [5, None, ["realsense"]])
def test_a_preset_that_is_no_path_is_told(preset):
    assert f"sensors.0.source: preset is {preset!r}, needs the path" in told({"preset": preset})


@pytest.mark.parametrize("source", ["lost.yaml", {"preset": "lost.yaml"}])
def test_the_field_of_a_preset_that_cannot_be_read_is_named(source):
    text = told(source)
    assert text.startswith("lab.yaml: sensors.0.source: lost.yaml: cannot be read")
    assert "\n" not in text


@pytest.mark.parametrize("field", ["T_chaser_sensor", "calibration"])
def test_the_field_of_a_file_that_cannot_be_read_is_named(field):
    sensor = {"kind": "pmd", field: "lost.yaml"}
    with pytest.raises(ConfigurationError) as error:
        check(EstimatorConfig, {"target": "mockup", "sensors": [sensor]}, source="lab.yaml")
    assert str(error.value).startswith(f"lab.yaml: sensors.0.{field}: lost.yaml: cannot be read")


@pytest.mark.parametrize(("topics", "changed"), [("[depth]", GIVEN), ("{depth: d}", ["depth"])])
def test_topics_that_are_no_mapping_are_told_beside_those_of_a_preset(tmp_path, topics, changed):
    file = tmp_path / "camera.yaml"
    file.write_text(f"topics: {topics}\nstamp: begin\n")
    assert "lab.yaml: sensors.0.source" in told({"preset": str(file), "topics": changed})


@pytest.mark.parametrize("field", ["clock_offset_s", "duration_s", "pair_within_s"])
def test_times_beyond_all_clocks_are_told(field):
    assert f"sensors.0.source.{field}: is 1e+300; it must be less than" in told({field: 1e300})


def test_sensors_of_one_name_are_told_with_the_name():
    sensors = [{"kind": "pmd", "name": "front"}] * 2
    with pytest.raises(ConfigurationError, match="sensors: two have the name 'front'"):
        check(EstimatorConfig, {"target": "mockup", "sensors": sensors}, source="lab.yaml")
