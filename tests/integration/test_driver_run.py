"""``rpod driver run`` and ``list``: frames reach the bus, and what cannot be used ends in one line."""

import json
import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest
import yaml
from ifm_recording import BUFFER, LENS
from live_bus import collect, daemon, first
from typer.testing import CliRunner

from rpod.__main__ import app
from rpod_driver import host
from rpod_driver.adapters.ifm import IFM
from rpod_driver.adapters.process import ProcessConfig
from rpod_driver.adapters.process import open_driver as open_process
from rpod_driver.registered import adapter, adapters
from rpod_runtime import Inbox
from rpod_schemas import registry
from rpod_schemas.config.driver import DriverConfig
from rpod_schemas.messages import read_depth, read_diagnostics, read_image, read_stamp
from rpod_schemas.registry import DRIVERS
from rpod_schemas.topics import AMPLITUDE, DEPTH, DEPTH_SIGMA, DIAGNOSTICS

SCRIPT = Path(__file__).parents[1] / "driver_script.py"
IFM_FILE = {
    "name": "front",
    "device": {"recording": str(BUFFER), "calibration": str(LENS), "rate_hz": 50.0, "repeat": 5},
}


def rpod(*arguments):
    return CliRunner().invoke(app, ["driver", *map(str, arguments)])


def written(folder, document):
    file = folder / "driver.yaml"
    file.write_text(yaml.safe_dump(document))
    return file


def told(received):
    return next((each for each in read_diagnostics(received.decode()) if each.name == "driver"), None)


def test_a_recorded_head_reaches_the_bus_with_its_noise_and_the_source_of_its_stamps(bus):
    inboxes = {topic: Inbox() for topic in (DEPTH, DEPTH_SIGMA, AMPLITUDE)}
    health = Inbox()
    node = bus.node("receiver")
    for topic, inbox in inboxes.items():
        node.subscribe(topic.of("front"), inbox.put, recover=True, history=True)
    node.subscribe(DIAGNOSTICS, health.put)
    config = IFM.config.model_validate(IFM_FILE | {"bus": {"connect": bus.endpoint}})
    with daemon(lambda config, **options: host.run(IFM.open(config), config, **options), config):
        messages = {topic: [each.decode() for each in collect(inbox, 5)] for topic, inbox in inboxes.items()}
        source = first(
            health, lambda each: (found := told(each)) and found.values.get("sync/front/stamp_source")
        )
    assert {topic.name: len(got) for topic, got in messages.items()} == dict.fromkeys(
        [topic.name for topic in inboxes], 5
    )
    stamps = {topic: [read_stamp(each.header) for each in got] for topic, got in messages.items()}
    assert stamps[DEPTH] == stamps[DEPTH_SIGMA] == stamps[AMPLITUDE]
    depth_m, sigma_m = read_depth(messages[DEPTH][0]), read_image(messages[DEPTH_SIGMA][0])
    assert np.array_equal(np.isfinite(depth_m), np.isfinite(sigma_m))
    assert np.nanmedian(depth_m) == pytest.approx(0.480, abs=1e-3)
    assert np.nanmedian(sigma_m) == pytest.approx(6.0e-4, abs=1e-5)
    assert source == "mapped"


def test_a_process_that_crashes_is_told_and_started_again(bus):
    depths, health = Inbox(), Inbox()
    node = bus.node("receiver")
    node.subscribe(DEPTH.of("front"), depths.put, recover=True, history=True)
    node.subscribe(DIAGNOSTICS, health.put)
    device = {"python": sys.executable, "script": SCRIPT, "arguments": ["crash"]}
    config = ProcessConfig.model_validate(
        {"name": "front", "kind": "pmd", "device": device, "retry_s": 0.1, "bus": {"connect": bus.endpoint}}
    )
    with daemon(lambda config, **options: host.run(open_process(config), config, **options), config):
        assert len(collect(depths, 4)) >= 4  # two of each connection
        failed = first(
            health,
            lambda each: (found := told(each)) and "ended with exit code 7" in found.message and found,
        )
    assert "bus error in the library" in failed.message
    assert int(failed.values["failures/front"]) >= 1


def test_the_drivers_are_listed_with_how_they_were_tested():
    shown = json.loads(rpod("list", "--json").stdout)["drivers"]
    names = [each["name"] for each in shown]
    assert names == ["genicam", "ifm", "ouster", "process", "realsense", "replay"]
    assert all(each["tested"] for each in shown)
    assert all(name in rpod("list").stdout for name in names)


@pytest.mark.parametrize("found", adapters(), ids=lambda each: each.name)
def test_each_driver_is_what_its_entry_point_says(found):
    assert adapter(found.name) is found
    assert issubclass(found.config, DriverConfig)
    assert callable(registry.resolve(found.build))


def test_another_package_brings_a_driver(monkeypatch):
    entry = EntryPoint("second", "rpod_driver.adapters.ifm:IFM", DRIVERS)
    monkeypatch.setattr(registry, "entry_points", lambda group: [entry] if group == DRIVERS else [])
    registry._entries.cache_clear()
    try:
        assert adapter("second") is IFM
    finally:
        registry._entries.cache_clear()
        registry.load.cache_clear()


@pytest.mark.parametrize(
    ("name", "changes", "code", "reason"),
    [
        ("kinect", {}, 2, "no installed package provides 'kinect' in rpod.drivers, known are genicam"),
        ("ifm", {"device": {}}, 2, "device: needs either ip"),
        ("ifm", {"kind": "lidar"}, 2, "kind: "),
        ("ifm", {"device": {"recording": "none.data"}}, 1, "none.data: cannot be read"),
        ("ifm", {"device": {"recording": str(BUFFER)}}, 1, "TOF_INFO is of version 1 with 312 bytes"),
    ],
)
def test_what_cannot_run_ends_with_one_line(tmp_path, name, changes, code, reason):
    ended = rpod("run", name, written(tmp_path, IFM_FILE | changes))
    assert ended.exit_code == code
    (line,) = ended.stderr.splitlines()
    assert reason in line


def test_a_library_that_is_not_installed_is_named_with_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "ifm3dpy", None)
    ended = rpod("run", "ifm", written(tmp_path, {"name": "front", "device": {"ip": "192.168.0.69"}}))
    assert ended.exit_code == 1
    assert "cannot load a library that it needs" in ended.stderr
    assert "pip install 'rpod[ifm]'" in ended.stderr
