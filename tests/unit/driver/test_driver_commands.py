"""The verbs of ``rpod driver``, as far as they need no bus."""

import sys
from types import SimpleNamespace

import pytest
import yaml

from rpod.driver.check import driver_of, kind_of_name
from rpod.driver.command import run_command
from rpod_schemas.errors import ConfigurationError
from rpod_schemas.registry import resolve

BUS = {"connect": "tcp/127.0.0.1:7449"}


def written(folder, **document):
    file = folder / "driver.yaml"
    file.write_text(yaml.safe_dump(document))
    return file


@pytest.mark.parametrize(
    ("document", "kind"),
    [
        ({"kind": "pmd"}, "pmd"),
        ({"kind": "pmd", "device": {"ip": "192.168.0.69"}}, "pmd"),
        ({"device": {"ip": "192.168.0.69", "port": "port3"}}, "pmd"),
        ({"device": {"python": "/opt/ouster/bin/python", "source": "os.local"}}, "lidar"),
        ({"kind": "lidar", "device": {"of_a_driver": "that is not installed"}, "more": 1}, "lidar"),
    ],
)
def test_a_check_takes_kind_name_and_bus_of_the_configuration_of_any_driver(tmp_path, document, kind):
    found = driver_of(written(tmp_path, name="front", bus=BUS, **document))
    assert (found.kind, found.name, found.bus.connect) == (kind, "front", BUS["connect"])


@pytest.mark.parametrize(
    ("name", "kind"), [("pmd", "pmd"), ("lidar_front", "lidar"), ("mono2", "mono"), ("front", "pmd")]
)
def test_a_check_without_a_kind_takes_that_with_which_the_name_begins(name, kind, monkeypatch):
    installed = [SimpleNamespace(name=known) for known in ("lidar", "mono", "pmd")]
    monkeypatch.setattr("rpod.driver.check.sensor_kinds", lambda: installed)
    assert kind_of_name(name) == kind


def test_a_check_of_a_configuration_whose_kind_nothing_tells_asks_for_it(tmp_path):
    file = written(tmp_path, name="front", device={"address": "somewhere"})
    with pytest.raises(ConfigurationError, match="kind: is missing, and no driver accepts the file"):
        driver_of(file)
    assert driver_of(file, "lidar").kind == "lidar"


def test_a_driver_whose_own_module_lacks_a_library_says_what_to_install(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "rpod_driver.adapters.replay.bag", None)
    monkeypatch.delitem(sys.modules, "rpod_driver.adapters.replay.driver", raising=False)
    resolve.cache_clear()
    file = written(tmp_path, kind="pmd", name="front", device={"bag": "run.mcap"})
    assert run_command("replay", file, connect=None, wait=False) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert "'replay' cannot load a library that it needs" in line
    assert line.endswith("pip install 'rpod[estimator]'")


def test_a_check_names_the_wrong_field_of_a_configuration(tmp_path):
    with pytest.raises(ConfigurationError, match=r"driver\.yaml: name"):
        driver_of(written(tmp_path, kind="pmd"))
