from pathlib import Path
from typing import Annotated

import numpy as np
import pytest
from pydantic import BeforeValidator, Field, TypeAdapter, ValidationError

from rpod_schemas.arrays import Vector3
from rpod_schemas.config.base import Config, Positive, check, in_place, load, read_document
from rpod_schemas.config.emulator import EmulatorConfig
from rpod_schemas.config.estimator import EstimatorConfig
from rpod_schemas.config.facility.logger import LoggerConfig
from rpod_schemas.config.scenario import Scenario, ScenarioEstimator
from rpod_schemas.config.service import RouterConfig
from rpod_schemas.errors import ConfigurationError
from rpod_schemas.poses import Pose


class Inner(Config):
    rate_hz: Positive
    """Rate."""


class Outer(Config):
    inner: Inner
    """Inner."""
    names: tuple[str, ...] = Field(default=())
    """Names."""
    T_chaser_sensor: Pose | None = None
    """Mount."""


@pytest.mark.parametrize(
    ("value", "told"),
    [
        ("abc", "is 'abc'; it needs 3 numbers, in brackets"),
        ([[1], [2, 3]], "is [[1], [2, 3]]; it needs 3 numbers, in brackets"),
        (7, "is one number; it needs 3 numbers, in brackets"),
        ([1, 2], "has 2 values; it needs 3"),
    ],
)
def test_what_is_no_vector_is_told_in_plain_words(value, told):
    with pytest.raises(ValidationError) as error:
        TypeAdapter(Vector3).validate_python(value)
    assert told in str(error.value)


def test_the_error_of_a_long_text_is_short():
    with pytest.raises(ConfigurationError) as error:
        check(RouterConfig, {"listen": 10_000 * "x"}, source="lab.yaml")
    assert len(str(error.value)) < 400


@pytest.mark.parametrize(
    ("text", "suffix"),
    [
        ("inner: {rate_hz: 3}", "yaml"),
        ("[inner]\nrate_hz = 3", "toml"),
        ('{"inner": {"rate_hz": 3}}', "json"),
    ],
)
def test_three_formats_read_alike(tmp_path, text, suffix):
    file = tmp_path / f"config.{suffix}"
    file.write_text(text)
    assert load(Outer, file).inner.rate_hz == 3


@pytest.mark.parametrize(
    ("document", "field", "reason"),
    [
        ({"inner": {"rate_hz": -1}}, "inner.rate_hz", "greater than 0"),
        ({"inner": {"rate_hz": 1}, "nmaes": []}, "nmaes", "not a known field"),
        ({}, "inner", "is missing"),
        ({"inner": {"rate_hz": -1}}, "inner.rate_hz", "is -1; it must be greater than 0"),
        ({"inner": {"rate_hz": "fast"}}, "inner.rate_hz", "is 'fast'; it must be a number"),
        ({"inner": {"rate_hz": None}}, "inner.rate_hz", "is None; it must be a number"),
        ({"inner": {"rate": 1}}, "inner.rate", "did you mean rate_hz? (and 1 more: inner.rate_hz)"),
        ({"iner": {"rate_hz": 1}}, "iner", "did you mean inner?"),
        ({"inner": {"rate_hz": 1}, "names": "front"}, "names", "is 'front'; it must be a list"),
        ({"inner": ["rate_hz"]}, "inner", "is ['rate_hz']; it must be a mapping, that is named fields"),
        (
            {"inner": {"rate_hz": 1}, "T_chaser_sensor": {"translation_m": [1, 2]}},
            "T_chaser_sensor",
            "it needs 3 finite numbers",
        ),
        (
            {"inner": {"rate_hz": 1}, "T_chaser_sensor": {"translation": [1, 2, 3]}},
            "T_chaser_sensor",
            "has the unknown field 'translation'; it needs translation_m, and quaternion_xyzw or",
        ),
        (
            {"inner": {"rate_hz": 1}, "T_chaser_sensor": {"quaternion_xyzw": [1e200, 0, 0, 0]}},
            "T_chaser_sensor",
            "quaternion_xyzw has the norm 1e+200",
        ),
        (
            {"inner": {"rate_hz": 1}, "T_chaser_sensor": {"quaternion_xyzw": [1, 1, 1, 1]}},
            "T_chaser_sensor",
            "it needs 1: x, y, z, w of a unit quaternion",
        ),
    ],
)
def test_an_error_names_source_field_and_reason_in_one_line(document, field, reason):
    with pytest.raises(ConfigurationError) as error:
        check(Outer, document, source="lab.yaml")
    text = str(error.value)
    assert text.startswith(f"lab.yaml: {field}")
    assert reason in text
    assert "\n" not in text


def test_a_wrong_item_is_one_error_and_the_list_is_not_called_too_short():
    class Listed(Config):
        items: Annotated[tuple[Annotated[int, Field(gt=0)], ...], Field(min_length=1)]

    with pytest.raises(ConfigurationError, match=r"items\.0: .*greater than 0$"):
        check(Listed, {"items": [-1]}, source="x")
    with pytest.raises(ConfigurationError, match=r"items: has 0 items; it needs 1 at least"):
        check(Listed, {"items": []}, source="x")


def test_a_mount_in_millimetres_and_a_namespace_with_slashes_at_its_ends_are_told_in_words():
    mount = {"translation_m": [120.0, 300.0, 0.0]}
    far = r"sensors\.0\.T_chaser_sensor: is 323.11, needs 0 to 200 m .*; translation_m is in metres"
    with pytest.raises(ConfigurationError, match=far):
        check(EstimatorConfig, {"sensors": [{"kind": "pmd", "T_chaser_sensor": mount}]}, source="x")
    with pytest.raises(ConfigurationError, match="needs names that begin with a letter"):
        check(EstimatorConfig, {"sensors": [{"kind": "pmd"}], "bus": {"namespace": "/a/"}}, source="x")


def test_several_errors_are_counted():
    with pytest.raises(ConfigurationError, match="and 1 more"):
        check(Outer, {"inner": {"rate_hz": -1}, "extra": 1}, source="x")


@pytest.mark.parametrize(("text", "words"), [("a: [", "expected"), ("- 1", "named fields"), ("\xff", "")])
def test_an_unreadable_file_is_named(tmp_path, text, words):
    file = tmp_path / "bad.yaml"
    file.write_text(text, "latin-1")
    with pytest.raises(ConfigurationError, match=r"bad\.yaml") as error:
        read_document(file)
    assert words in str(error.value)
    assert "\n" not in str(error.value)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(ConfigurationError, match=r"none\.yaml: cannot be read"):
        read_document(tmp_path / "none.yaml")


def test_a_file_with_a_nearly_right_name_is_proposed_and_a_missing_folder_named(tmp_path):
    (tmp_path / "kepler.yaml").write_text("a: 1")
    (tmp_path / "kepler.obj").write_text("")
    with pytest.raises(ConfigurationError, match=r"did you mean .*/kepler\.yaml\?$"):
        read_document(tmp_path / "keppler.yaml")
    for unlike in ("quite-another.yaml", "kip.yaml"):
        with pytest.raises(ConfigurationError, match=r"directory\)$"):
            read_document(tmp_path / unlike)
    with pytest.raises(ConfigurationError, match=r"there is no folder .*/lost$"):
        read_document(tmp_path / "lost" / "kepler.yaml")


def test_a_missing_file_of_a_relative_path_is_told_with_the_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigurationError) as error:
        read_document(Path("none.yaml"))
    assert str(error.value) == f"none.yaml: cannot be read (No such file or directory) in {tmp_path}"


def test_a_file_is_not_proposed_for_a_field_of_its_own(tmp_path):
    class Outer(Config):
        inner: Annotated[dict, BeforeValidator(lambda value: in_place(value, read_document))]

    file = tmp_path / "camera.yaml"
    file.write_text(f"inner: {tmp_path}/camera1.yaml")
    with pytest.raises(ConfigurationError) as error:
        load(Outer, file)
    assert "camera1.yaml: cannot be read" in str(error.value)
    assert "did you mean" not in str(error.value)
    with pytest.raises(ConfigurationError, match="did you mean"):
        read_document(tmp_path / "camera1.yaml")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a: 1\nb\nc: 2\n", "line 2, column 1: could not find expected ':'"),
        ("a: 1\n\tb: 2\n", "line 2, column 1: there is a tab; YAML is indented with spaces"),
        (
            "bus: {}\nseed: 1\nbus: {}\n",
            "line 3, column 1: 'bus' is given a second time, after line 1; leave one of the two",
        ),
        (
            "inner: {a: 1, b: 2, a: 3}",
            "line 1, column 21: 'a' is given a second time, after line 1; leave one of the two",
        ),
        (
            "a: 1\nepoch: 2026-13-01\n",
            "line 2, column 8: is no value that can be read (month must be in 1..12); "
            "quote it if it is a text",
        ),
    ],
)
def test_an_error_of_syntax_is_told_with_its_line(tmp_path, text, words):
    file = tmp_path / "bad.yaml"
    file.write_text(text)
    with pytest.raises(ConfigurationError) as error:
        read_document(file)
    assert str(error.value) == f"{file}: {words}"


@pytest.mark.parametrize("suffix", ["yaml", "toml", "json"])
def test_a_number_of_too_many_digits_is_told_in_one_line(tmp_path, suffix):
    file = tmp_path / f"bad.{suffix}"
    number = "9" * 5000
    file.write_text(
        {"toml": f"seed = {number}", "json": f'{{"seed": {number}}}'}.get(suffix, f"seed: {number}")
    )
    with pytest.raises(ConfigurationError, match="5000 digits") as error:
        read_document(file)
    assert "\n" not in str(error.value)


def test_a_mapping_may_change_what_it_merges(tmp_path):
    file = tmp_path / "merged.yaml"
    file.write_text("c: {<<: &b {<<: &a {x: 1, y: 1}, x: 2}, y: 3}\nb: *b\na: *a\n")
    assert read_document(file) == {"c": {"x": 2, "y": 3}, "b": {"x": 2, "y": 1}, "a": {"x": 1, "y": 1}}


def test_a_pose_is_written_as_it_is_read():
    outer = check(
        Outer,
        {
            "inner": {"rate_hz": 1},
            "T_chaser_sensor": {"euler_321_deg": [90, 0, 0], "translation_m": [1, 2, 3]},
        },
        source="x",
    )
    again = Outer.model_validate_json(outer.model_dump_json())
    np.testing.assert_allclose(
        again.T_chaser_sensor.as_matrix(), outer.T_chaser_sensor.as_matrix(), atol=1e-15
    )


def test_a_configuration_is_frozen():
    config = LoggerConfig()
    with pytest.raises(ValueError, match="frozen"):
        config.instance = "other"


SCENARIO = {
    "name": "two-sensors",
    "title": "A camera and a LIDAR before the mock-up",
    "target": "mockup",
    "duration_s": 5.0,
    "motion": {
        "trajectory": {"kind": "approach", "start_m": [0, 0, 6], "end_m": [0, 0, 3]},
        "attitude": {"kind": "spin", "axis": [1, 0, 0], "rate_deg_s": 3},
        "sun": {"direction": [0, 0, -1]},
    },
    "sensors": [{"kind": "pmd", "name": "near"}, {"kind": "lidar"}],
}


def test_an_estimator_may_look_for_another_model_than_the_sensors_see():
    same = Scenario.model_validate(SCENARIO)
    other = Scenario.model_validate(SCENARIO | {"estimator": {"target": "mockup@off=5mm"}})
    assert (same.target, same.model) == (SCENARIO["target"], SCENARIO["target"])
    assert (other.target, other.model) == (SCENARIO["target"], "mockup@off=5mm")


def test_the_estimator_of_a_scenario_listens_to_all_sensors_if_it_names_none():
    considered = {"filter": {"errors": "considered"}}
    for estimator in ({}, {"estimator": {}}, {"estimator": considered}, {"estimator": ScenarioEstimator()}):
        scenario = Scenario.model_validate(SCENARIO | estimator)
        heard = [(sensor.kind, sensor.name) for sensor in scenario.estimator.sensors]
        assert heard == [("pmd", "near"), ("lidar", "lidar")]
        assert (scenario.estimator.filter.errors == "considered") == ({"estimator": considered} == estimator)
    only = {"estimator": {"sensors": [{"kind": "lidar"}]}}
    assert [each.kind for each in Scenario.model_validate(SCENARIO | only).estimator.sensors] == ["lidar"]


def test_what_a_scenario_may_leave_out_is_required_neither_by_its_model_nor_by_the_json_schema():
    assert {name for name, field in Scenario.model_fields.items() if field.is_required()} == set(SCENARIO)
    assert "required" not in ScenarioEstimator.model_json_schema()


@pytest.mark.parametrize(
    "sensors",
    [[], [{"kind": "sonar"}], [7], "pmd", [{"kind": "pmd"}, {"kind": "pmd"}], [{"kind": "pmd", "name": ""}]],
)
def test_wrong_sensors_of_a_scenario_are_told_at_their_place_alone(sensors):
    with pytest.raises(ConfigurationError) as raised:
        check(Scenario, SCENARIO | {"sensors": sensors}, source="mine.yaml")
    assert str(raised.value).startswith("mine.yaml: sensors")
    assert "estimator" not in str(raised.value)


def test_an_emulator_with_two_sensors_of_one_name_is_refused():
    with pytest.raises(ConfigurationError, match=r"sensors: two have the name 'pmd'"):
        check(
            EmulatorConfig,
            {"target": "mockup", "sensors": [{"kind": "pmd"}, {"kind": "pmd"}]},
            source="mine.yaml",
        )


def test_an_estimator_that_uses_no_sensor_is_refused():
    with pytest.raises(ConfigurationError, match=r"estimator\.sensors: has 0 items; it needs 1 at least"):
        check(Scenario, SCENARIO | {"estimator": {"sensors": []}}, source="mine.yaml")


def test_a_sensor_that_is_not_emulated_is_named_beside_those_that_are():
    document = SCENARIO | {"sensors": [{"kind": "pmd"}], "estimator": {"sensors": [{"kind": "lidar"}]}}
    with pytest.raises(ConfigurationError, match=r"no lidar called 'lidar' .* sensors has pmd 'pmd'"):
        check(Scenario, document, source="mine.yaml")


def test_a_vector_with_too_few_numbers_is_told_how_many_it_needs():
    motion = SCENARIO["motion"] | {"trajectory": {"kind": "approach", "start_m": [0, 6], "end_m": [0, 0, 3]}}
    with pytest.raises(ConfigurationError, match=r"start_m: has 2 values; it needs 3"):
        check(Scenario, SCENARIO | {"motion": motion, "sensors": [{"kind": "pmd"}]}, source="mine.yaml")


def test_a_scenarios_title_may_be_short():
    assert Scenario.model_validate(SCENARIO | {"title": "A"}).title == "A"


class Lengths(Config):
    lengths: tuple[Positive | Annotated[str, Field(pattern=r"^[0-9]+x$")], ...]


def test_a_place_that_may_have_several_types_is_named_once() -> None:
    with pytest.raises(ConfigurationError, match=r"greater than 0 \(and 1 more: lengths\.2\)$") as refused:
        check(Lengths, {"lengths": ["0", "3x", "x"]}, source="")
    assert refused.value.field == "lengths.0"
