"""What ``rpod driver new`` writes runs at once: its tests pass, its configuration and unit can be read."""

import os
import subprocess
import sys
from configparser import ConfigParser

import pytest

from rpod_driver.scaffold import TEMPLATES, ScaffoldError, scaffold
from rpod_schemas.config.base import load
from rpod_schemas.config.driver import DriverConfig


@pytest.mark.parametrize("template", TEMPLATES)
def test_the_tests_of_a_new_driver_pass_before_anything_is_changed(template, tmp_path):
    folder = scaffold(template, "my_camera", tmp_path)
    chosen = [] if template == "custom" else ["-k", "check"]  # the rest is the same for all
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "no:dash", *chosen],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert ("5 passed" if template == "custom" else "1 passed") in done.stdout


@pytest.mark.parametrize("template", TEMPLATES)
def test_its_configuration_and_its_unit_can_be_read(template, tmp_path):
    folder = scaffold(template, "my_camera", tmp_path)
    config = load(DriverConfig, folder / "driver.yaml")
    assert (config.kind, config.name, config.bus.wait) == (TEMPLATES[template], "my_camera", True)
    unit = ConfigParser(interpolation=None)
    unit.optionxform = str
    unit.read_string((folder / "my_camera.service").read_text())
    assert unit["Service"]["ExecStart"].endswith("-m my_camera /etc/rpod/my_camera.yaml")
    written = [file for file in folder.rglob("*") if file.is_file()]
    assert not [file for file in written if "${" in file.read_text() or "$" in file.name]


@pytest.mark.parametrize(
    ("template", "name", "text"),
    [("velodyne", "my_camera", "known are custom"), ("custom", "My-Camera", "small letters"),
     ("custom", "there", "exists already")],
)  # fmt: skip
def test_what_cannot_be_written_is_refused_with_the_remedy(template, name, text, tmp_path):
    (tmp_path / "there").mkdir()
    with pytest.raises(ScaffoldError, match=text):
        scaffold(template, name, tmp_path)
