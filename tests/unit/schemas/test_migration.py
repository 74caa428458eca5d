import json
import logging
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel

from rpod_schemas.config.emulator import EmulatorConfig
from rpod_schemas.config.estimator import EstimatorConfig
from rpod_schemas.config.migration import (
    CONFIG_VERSION,
    MERGED,
    VERSION_FIELD,
    check_logged,
    logged,
    renamed_since,
)
from rpod_schemas.errors import ConfigurationError

OF_AN_EARLIER_VERSION = {
    "target": "mockup",
    "sensors": [
        {"kind": "pmd", "verification": {"max_cost_m2": 0.003}, "tracking": {"kind": "joint", "gone": 1}},
        {"kind": "lidar", "verification": {"max_cost_m2": 0.003}},
    ],
    "verbosity": 3,
}


def of_version_1() -> dict[str, Any]:
    """A configuration out of the log of a run with a PMD camera and a LIDAR, before there was a version."""
    file = Path(__file__).parent / "logged" / "estimator-version-1.json"
    document: dict[str, Any] = json.loads(file.read_text("utf-8"))
    return document


def of_version_2() -> dict[str, Any]:
    """The same configuration as version 2 logged it: with tuning, renamed fields under their old names."""
    config = check_logged(EstimatorConfig, of_version_1(), source="run.mcap").config
    return {**with_old_names(config, 2), VERSION_FIELD: 2}


def of_today() -> EstimatorConfig:
    """The same configuration as today's model has it."""
    return check_logged(EstimatorConfig, of_version_1(), source="run.mcap").config


def with_old_names(config: BaseModel, version: int) -> dict[str, Any]:
    """A configuration as it is logged, its fields under the names that they had in a version."""
    old_names = {new: old for old, new in renamed_since(version).items()}

    def older(value: Any) -> Any:
        if isinstance(value, dict):
            return {old_names.get(key, key): older(item) for key, item in value.items()}
        return [older(item) for item in value] if isinstance(value, list) else value

    document: dict[str, Any] = older(logged(config))
    return document


def leaves(document: Any, place: tuple[str, ...] = ()) -> dict[tuple[str, ...], Any]:
    """All values of a document by their place, without the parts of it that are called tuning."""
    if isinstance(document, dict):
        pairs = [(str(key), value) for key, value in document.items()]
    elif isinstance(document, list) and any(isinstance(item, dict) for item in document):
        pairs = [(str(index), value) for index, value in enumerate(document)]
    else:
        return {place: document}
    found: dict[tuple[str, ...], Any] = {}
    for key, value in pairs:
        found |= leaves(value, place if key == "tuning" else (*place, key))
    return found


def renamed(place: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(renamed_since(1).get(name, name) for name in place)


def test_fields_that_are_gone_are_left_out_and_named_with_their_place() -> None:
    migrated = check_logged(EstimatorConfig, OF_AN_EARLIER_VERSION, source="run.mcap")
    assert [sensor.kind for sensor in migrated.config.sensors] == ["pmd", "lidar"]
    assert sorted(migrated.unknown) == [
        "sensors.0.tracking.gone",
        "sensors.0.verification",
        "sensors.1.verification",
        "verbosity",
    ]
    assert migrated.tuned == ()


def test_a_value_that_is_wrong_today_is_an_error_that_names_the_field() -> None:
    with pytest.raises(ConfigurationError, match=r"run\.mcap.*max_future_s"):
        check_logged(EstimatorConfig, {**OF_AN_EARLIER_VERSION, "max_future_s": -1.0}, source="run.mcap")


def test_the_document_itself_stays_as_it_is() -> None:
    document = of_version_1()
    check_logged(EstimatorConfig, document, source="run.mcap")
    assert document == of_version_1()


def test_every_value_of_a_logged_configuration_is_kept_or_named_as_unknown() -> None:
    document = of_version_1()
    migrated = check_logged(EstimatorConfig, document, source="run.mcap")
    today = leaves(migrated.config.model_dump(mode="json"))
    logged_values = {place: (renamed(place), value) for place, value in leaves(document).items()}
    lost = {place for place, (now, value) in logged_values.items() if today.get(now, "missing") != value}
    gone = [tuple(name.split(".")) for name in migrated.unknown]
    lost -= {place for pairs in MERGED.values() for place in pairs}  # each has the other field's value
    assert all(any(place[: len(name)] == name for name in gone) for place in lost), lost


def test_values_that_are_now_tuning_stay_what_the_log_says() -> None:
    document = of_version_1()
    pmd, lidar = document["sensors"]
    pmd["tracking"] |= {"far_iterations": 11, "slack_m": 0.002}
    pmd["tracking"]["depth"]["points"] = 777
    lidar["acquisition"]["tracking"]["verdict"]["pessimistic"]["clutter_share"] = 0.07
    document["navigator"]["vague_deg"] = 4.5
    migrated = check_logged(EstimatorConfig, document, source="run.mcap")
    found = migrated.config.model_dump()
    tracking = found["sensors"][0]["tracking"]
    assert (tracking["slack_m"], tracking["tuning"]["far_iterations"]) == (0.002, 11)
    assert tracking["tuning"]["depth"]["points"] == 777
    scans = found["sensors"][1]["acquisition"]["tracking"]["tuning"]
    assert scans["acceptance"]["pessimistic"]["clutter_share"] == 0.07
    assert found["navigator"]["tuning"]["vague_deg"] == 4.5
    assert {"sensors.0.tracking.far_iterations", "navigator.vague_deg"} < set(migrated.tuned)
    assert "sensors.0.tracking.slack_m" not in migrated.tuned
    assert "sensors.0.acquisition.model.foil_share" in migrated.unknown


def test_renamed_fields_of_version_1_keep_their_values_and_are_named() -> None:
    document = of_version_1()
    pmd, lidar = document["sensors"]
    pmd["tracking"]["check"]["most_contrary_share"] = 0.03
    lidar["acquisition"] |= {"draw_in_points": 99, "draw_in_steps": 7, "sharpened_returns": 71}
    lidar["tracking"] |= {"draw_in_steps": 4, "settle_steps": 2}
    lidar["tracking"]["verdict"]["contrary_share"] = 0.05
    migrated = check_logged(EstimatorConfig, document, source="run.mcap")
    camera, scanner = migrated.config.model_dump()["sensors"]
    assert camera["tracking"]["tuning"]["check"]["most_inconsistent_share"] == 0.03
    search, tracking = scanner["acquisition"]["tuning"], scanner["tracking"]["tuning"]
    assert [search[name] for name in ("coarse_points", "coarse_steps", "sufficient_returns")] == [99, 7, 71]
    assert (tracking["coarse_steps"], tracking["fine_steps"]) == (4, 2)
    assert tracking["acceptance"]["inconsistent_share"] == 0.05
    assert {
        "sensors.0.tracking.check.most_contrary_share -> most_inconsistent_share",
        "sensors.1.acquisition.draw_in_steps -> coarse_steps",
        "sensors.1.tracking.verdict.contrary_share -> inconsistent_share",
    } < set(migrated.renamed)
    assert "sensors.1.acquisition.draw_in_steps" in migrated.tuned


def test_a_log_of_version_2_is_read_with_its_values_and_the_renamed_fields_are_named(
    caplog: pytest.LogCaptureFixture,
) -> None:
    document = of_version_2()
    document["sensors"][1]["tracking"]["tuning"]["settle_steps"] = 2
    migrated = check_logged(EstimatorConfig, document, source="run.mcap")
    migrated.report("run.mcap")
    assert (migrated.version, migrated.tuned, migrated.unknown) == (2, (), ())
    names = {name.rpartition(".")[2].split(" -> ")[0] for name in migrated.renamed}
    assert names == renamed_since(2).keys() - {"thinned"}  # which is a field of sensors and drivers
    assert migrated.config.model_dump()["sensors"][1]["tracking"]["tuning"]["fine_steps"] == 2
    (line,) = caplog.messages
    assert "is of version 2" in line
    assert "settle_steps -> fine_steps" in line


def test_a_log_of_version_4_is_read_with_the_names_and_the_tuning_of_version_5(
    caplog: pytest.LogCaptureFixture,
) -> None:
    config = check_logged(EstimatorConfig, of_version_1(), source="run.mcap").config
    document = {**with_old_names(config, 4), VERSION_FIELD: 4}
    camera, scanner = document["sensors"]
    camera["acquisition"]["attitudes"] = 2500
    scanner["tracking"]["tuning"]["verdict"]["inconsistent_share"] = 0.05
    migrated = check_logged(EstimatorConfig, document, source="run.mcap")
    migrated.report("run.mcap")
    found = migrated.config.model_dump()["sensors"]
    assert found[0]["acquisition"]["tuning"]["attitudes"] == 2500
    assert found[1]["tracking"]["tuning"]["acceptance"]["inconsistent_share"] == 0.05
    assert (migrated.tuned, migrated.unknown) == (("sensors.0.acquisition.attitudes",), ())
    (line,) = caplog.messages
    assert "now tuning: sensors.0.acquisition (attitudes)" in line
    assert "verdict -> acceptance" in line


@pytest.mark.parametrize(("value", "unknown"), [(0.2, ()), (0.4, ("navigator.coasting_after_s",))])
def test_a_merged_field_is_named_only_where_it_had_another_value(value: float, unknown: tuple[str]) -> None:
    document = {**logged(of_today()), VERSION_FIELD: 5}
    document["navigator"]["coasting_after_s"] = value
    migrated = check_logged(EstimatorConfig, document, source="run.mcap")
    assert (migrated.version, migrated.unknown) == (5, unknown)
    assert migrated.config.stale_after_s == 0.2


@pytest.mark.parametrize(("value", "unknown"), [(1.0, ()), (3.0, ("max_age_s",))])
def test_a_log_of_version_6_keeps_the_values_of_version_7(value: float, unknown: tuple[str]) -> None:
    document = {**logged(of_today()), VERSION_FIELD: 6, "max_age_s": value}
    document["filter"]["correlation_inflation"] = 4.0
    document["navigator"]["near_search_s"] = 2.0
    migrated = check_logged(EstimatorConfig, document, source="run.mcap")
    assert migrated.config.filter.tuning.correlation_inflation == 4.0
    assert migrated.config.navigator.tuning.near_search_s == 2.0
    assert set(migrated.tuned) == {"filter.correlation_inflation", "navigator.near_search_s"}
    assert migrated.unknown == unknown


def test_a_logged_camera_with_a_thinned_stream_has_it_under_its_present_name() -> None:
    sensor = {"kind": "pmd", "name": "pmd", "thinned": {"mbit_s": 8}}
    document = {"target": "mockup", "sensors": [sensor], VERSION_FIELD: 4}
    migrated = check_logged(EmulatorConfig, document, source="run.mcap")
    assert migrated.renamed == ("sensors.0.thinned -> reduced_rate",)
    assert migrated.config.model_dump()["sensors"][0]["reduced_rate"]["mbit_s"] == 8


def test_of_a_field_that_has_both_names_the_old_one_is_unknown() -> None:
    document = of_version_2()
    document["sensors"][1]["tracking"]["tuning"]["fine_steps"] = 9
    migrated = check_logged(EstimatorConfig, document, source="run.mcap")
    assert migrated.unknown == ("sensors.1.tracking.tuning.settle_steps",)
    assert migrated.config.model_dump()["sensors"][1]["tracking"]["tuning"]["fine_steps"] == 9


def test_of_todays_version_an_old_name_is_unknown() -> None:
    config = check_logged(EstimatorConfig, of_version_2(), source="run.mcap").config
    document = logged(config)
    document["sensors"][1]["tracking"]["tuning"]["settle_steps"] = 2
    migrated = check_logged(EstimatorConfig, document, source="run.mcap")
    assert migrated.renamed == ()
    assert "sensors.1.tracking.tuning.settle_steps" in migrated.unknown


def test_a_renamed_field_that_no_model_has_is_named_as_the_log_has_it() -> None:
    document = {**OF_AN_EARLIER_VERSION, "filter": {"settle_steps": 3}}
    migrated = check_logged(EstimatorConfig, document, source="run.mcap")
    assert "filter.settle_steps" in migrated.unknown
    assert (migrated.tuned, migrated.renamed) == ((), ())


def test_one_line_names_what_is_now_tuning_and_what_is_unknown(caplog: pytest.LogCaptureFixture) -> None:
    document = {**OF_AN_EARLIER_VERSION, "filter": {"gate_nis": 12.0}}
    with caplog.at_level(logging.WARNING):
        check_logged(EstimatorConfig, document, source="run.mcap").report("run.mcap")
    (line,) = caplog.messages
    assert line.startswith(
        f"run.mcap: is of version 1, today's is {CONFIG_VERSION}; now tuning: filter (gate_nis)"
    )
    assert "unknown and left out: " in line
    assert "sensors.0.tracking (gone)" in line


def test_what_is_logged_today_has_a_version_and_is_read_without_a_word(
    caplog: pytest.LogCaptureFixture,
) -> None:
    config = check_logged(EstimatorConfig, of_version_1(), source="run.mcap").config
    document = logged(config)
    assert document[VERSION_FIELD] == CONFIG_VERSION
    again = check_logged(EstimatorConfig, document, source="run.mcap")
    again.report("run.mcap")
    assert (again.tuned, again.unknown, caplog.messages) == ((), (), [])
    assert logged(again.config) == document


def test_of_todays_version_a_field_that_stands_beside_tuning_is_unknown() -> None:
    document = {**OF_AN_EARLIER_VERSION, VERSION_FIELD: CONFIG_VERSION, "filter": {"gate_nis": 12.0}}
    migrated = check_logged(EstimatorConfig, document, source="run.mcap")
    assert "filter.gate_nis" in migrated.unknown
    assert migrated.config.filter.tuning.gate_nis == 16.8
