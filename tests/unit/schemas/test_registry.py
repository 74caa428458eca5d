from importlib.metadata import EntryPoint

import pytest

from rpod_schemas import registry
from rpod_schemas.config import pmd_methods as documented
from rpod_schemas.config.base import check
from rpod_schemas.config.driver import DriverConfig
from rpod_schemas.config.emulator import EmulatorConfig
from rpod_schemas.config.estimator import EstimatorSettings, PmdInput
from rpod_schemas.config.pmd import PmdConfig
from rpod_schemas.config.pmd import methods as parameters
from rpod_schemas.config.pmd.joint import JointConfig
from rpod_schemas.errors import ConfigurationError
from rpod_schemas.registry import METHODS, SENSORS, RegistryError, UnknownNameError, names, resolve
from rpod_schemas.sensors import method, methods, sensor_kind, sensor_kinds
from rpod_schemas.topics import TOPICS


@pytest.fixture
def entries(monkeypatch: pytest.MonkeyPatch):
    """Replace what is installed."""

    def installed(*found: EntryPoint) -> None:
        registry._entries.cache_clear()
        registry.load.cache_clear()
        monkeypatch.setattr(registry, "entry_points", lambda group: [e for e in found if e.group == group])

    yield installed
    registry._entries.cache_clear()
    registry.load.cache_clear()


@pytest.mark.parametrize("kind", sensor_kinds(), ids=lambda kind: kind.name)
def test_everything_that_a_kind_refers_to_is_there(kind):
    needed = (kind.reader, kind.publisher, kind.emulator, kind.methods)
    for reference in (*needed, *filter(None, (kind.checks, kind.reduced_rate))):
        assert resolve(reference) is not None
    assert kind.emulated.model_fields["kind"].default == kind.heard.model_fields["kind"].default == kind.name
    assert {topic.name for topic in kind.topics} <= {topic.name for topic in TOPICS}


def test_the_documented_path_of_a_methods_parameters_stays():
    assert all(getattr(parameters, name) is getattr(documented, name) for name in documented.__all__)


@pytest.mark.parametrize("name", names(METHODS))
def test_everything_that_a_method_refers_to_is_there_under_its_own_name(name):
    sensor, _, own = name.partition(".")
    assert method(sensor, own).name == own
    assert callable(resolve(method(sensor, own).build))


def test_a_document_is_read_and_written_as_the_model_of_its_kind():
    document = {"target": "mockup", "sensors": [{"kind": "pmd", "profile": "paper"}, {"kind": "lidar"}]}
    config = check(EmulatorConfig, document, source="file")
    assert isinstance(config.sensors[0], PmdConfig)
    again = EmulatorConfig.model_validate_json(config.model_dump_json())
    assert again.model_dump_json() == config.model_dump_json()
    assert '"profile":"paper"' in again.model_dump_json()


@pytest.mark.parametrize(
    ("sensor", "text"),
    [
        (
            {"kind": "mono"},
            r"sensors\.0\.kind: no installed package provides 'mono' .* known are lidar, pmd;",
        ),
        ({}, r"sensors\.0\.kind: is missing, known are lidar, pmd"),
        (3, r"sensors\.0: needs named fields"),
        (
            {"kind": "pmd", "tracking": {"kind": "x"}},
            r"tracking\.kind: no installed package provides 'x' in rpod\.methods, known are epnp, .*joint",
        ),
        (
            {"kind": "pmd", "acquisition": {"kind": "global"}},
            r"acquisition\.kind: no installed package provides 'global' .*, known are view_search; correct",
        ),
        ({"kind": "pmd", "tracking": {"kind": "view_search"}}, r"'view_search' is no method for tracking"),
        ({"kind": "pmd", "tracking": {"kind": "joint", "far_points": 0}}, r"tracking\.far_points: "),
    ],
)
def test_an_error_names_the_field_and_what_is_known(sensor, text):
    with pytest.raises(ConfigurationError, match=text):
        check(EstimatorSettings, {"sensors": [sensor]}, source="file")


def test_a_model_does_not_take_another_kind():
    with pytest.raises(ValueError, match="is 'lidar', PmdInput needs 'pmd'"):
        PmdInput(kind="lidar")


def test_a_driver_is_of_a_known_kind():
    with pytest.raises(ConfigurationError, match="kind: no installed package provides 'sonar'"):
        check(DriverConfig, {"kind": "sonar", "name": "s"}, source="file")


def test_an_acquisition_without_a_kind_is_the_default():
    assert (
        PmdInput.model_validate({"acquisition": {"tuning": {"attitudes": 100}}}).acquisition.kind
        == "view_search"
    )


def test_the_schema_of_an_estimator_describes_every_installed_kind_and_method():
    text = str(EstimatorSettings.model_json_schema())
    for each in methods("pmd", "tracking"):
        assert f"'default': '{each.name}'" in text


def test_an_entry_of_the_wrong_type_or_without_a_module_names_its_package(entries):
    entries(
        EntryPoint("broken", "no_such_module:KIND", SENSORS),
        EntryPoint("odd", "rpod_schemas.config.pmd.joint:JointConfig", SENSORS),
    )
    with pytest.raises(RegistryError, match=r"broken.*cannot be loaded"):
        sensor_kind("broken")
    with pytest.raises(RegistryError, match=r"odd.*needs SensorKind"):
        sensor_kind("odd")


def test_two_packages_that_bring_one_name_are_an_error(entries):
    entries(EntryPoint("pmd", "a:KIND", SENSORS), EntryPoint("pmd", "b:KIND", SENSORS))
    with pytest.raises(RegistryError, match="has the name of"):
        names(SENSORS)


def test_a_misspelt_name_gets_the_nearest_known_one():
    with pytest.raises(UnknownNameError, match="did you mean 'lidar'"):
        sensor_kind("lidr")


def test_an_environment_without_entry_points_is_told_to_install_again(entries):
    entries()
    with pytest.raises(UnknownNameError, match="install it again"):
        sensor_kind("pmd")


def test_a_subclass_under_another_name_keeps_its_parameters():
    class Mine(JointConfig):
        kind: str = "mine"

    assert Mine(slack_m=0.007).kind == "mine"
    with pytest.raises(ValueError, match="Mine needs 'mine'"):
        Mine(kind="joint")
