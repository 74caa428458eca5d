"""What ``rpod driver new`` writes runs at once: its tests pass, its configuration and unit can be read."""

import os
import re
import subprocess
import sys
import tomllib
from configparser import ConfigParser
from contextlib import ExitStack
from importlib import import_module

import pytest
from ifm_recording import PlayedSdk

from rpod_driver.registered import Adapter
from rpod_driver.scaffold import TEMPLATES, ScaffoldError, scaffold
from rpod_schemas.config.base import load
from rpod_schemas.config.driver import DriverConfig
from rpod_schemas.registry import resolve


@pytest.fixture(scope="module")
def running(tmp_path_factory):
    """The tests of a new driver of each template, which mostly wait, started at the same time."""
    folders = {name: scaffold(name, "my_camera", tmp_path_factory.mktemp(name)) for name in TEMPLATES}
    with ExitStack() as stack:
        yield {name: stack.enter_context(_started(name, folder)) for name, folder in folders.items()}


def _started(template, folder):
    chosen = [] if template == "custom" else ["-k", "check"]  # the rest is the same for all
    return subprocess.Popen(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "no:dash", *chosen],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


@pytest.mark.parametrize("template", TEMPLATES)
def test_the_tests_of_a_new_driver_pass_before_anything_is_changed(template, running):
    said, _ = running[template].communicate(timeout=120)
    assert running[template].returncode == 0, said
    assert ("5 passed" if template == "custom" else "1 passed") in said


@pytest.mark.parametrize("template", TEMPLATES)
def test_its_configuration_and_its_unit_can_be_read(template, tmp_path):
    folder = scaffold(template, "my_camera", tmp_path)
    config = load(DriverConfig, folder / "driver.yaml")
    assert (config.kind, config.name, config.bus.wait) == (TEMPLATES[template], "my_camera", True)
    text = (folder / "driver.yaml").read_text()
    (folder / "set.yaml").write_text(re.sub("^# (settings:|  )", r"\1", text, flags=re.M))
    assert load(DriverConfig, folder / "set.yaml").settings
    unit = ConfigParser(interpolation=None)
    unit.optionxform = str
    unit.read_string((folder / "my_camera.service").read_text())
    assert unit["Service"]["ExecStart"].endswith("-m my_camera /etc/rpod/my_camera.yaml")
    written = [file for file in folder.rglob("*") if file.is_file()]
    assert not [file for file in written if "${" in file.read_text() or "$" in file.name]


@pytest.mark.parametrize("template", TEMPLATES)
def test_it_can_be_started_by_its_name(template, tmp_path, monkeypatch):
    name = f"camera_of_{template}"
    folder = scaffold(template, name, tmp_path)
    entries = tomllib.loads((folder / "pyproject.toml").read_text())["project"]["entry-points"]
    monkeypatch.syspath_prepend(str(folder / "src"))
    adapter = resolve(entries["rpod.drivers"][name])
    assert isinstance(adapter, Adapter)
    assert adapter.name == name
    config = load(adapter.config, folder / "driver.yaml")
    driver = adapter.open(config)
    driver.connect()  # to the simulated device
    driver.close()


@pytest.mark.parametrize(
    ("template", "name", "text"),
    [("velodyne", "my_camera", "known are custom"), ("custom", "My-Camera", "small letters"),
     ("custom", "there", "exists already")],
)  # fmt: skip
def test_what_cannot_be_written_is_refused_with_the_remedy(template, name, text, tmp_path):
    (tmp_path / "there").mkdir()
    with pytest.raises(ScaffoldError, match=text):
        scaffold(template, name, tmp_path)


def test_the_package_for_ifm_drives_a_live_head_by_the_projects_driver(tmp_path, monkeypatch):
    folder = scaffold("ifm", "my_head", tmp_path)
    monkeypatch.syspath_prepend(folder / "src")
    monkeypatch.setattr("rpod_driver.adapters.ifm.driver.sdk", lambda *_, **__: PlayedSdk())
    driver = import_module("my_head").MyHead("192.168.0.69", "port3")
    driver.connect()
    frame = next(each for each in driver.frames() if each is not None)
    driver.close()
    assert frame.depth_sigma_m is not None
    assert driver.settings() == {
        "ip": "192.168.0.69", "port": "port3", "acquisition/framerate": 10.0, "mode": "standard_range2m"
    }  # fmt: skip
    with pytest.raises(ValueError, match="port is 'port3' since the start"):
        driver.apply({"port": "port2"})
