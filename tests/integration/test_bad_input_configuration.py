"""A service that is configured wrongly ends at once, with exit code 2 and one line: file, field, reason."""

import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from typer.testing import CliRunner

from rpod.__main__ import app
from rpod_runtime.bus.session import free_endpoint
from rpod_target import load_target

GOOD = {
    "router": {},
    "motion": {"target": "mockup", "motion": {}, "duration_s": 1.0},
    "emulator": {"target": "mockup", "sensors": [{"kind": "pmd"}]},
    "estimator": {"target": "mockup", "sensors": [{"kind": "pmd"}]},
    "logger": {},
}


def ended(verb: str, file: Path) -> tuple[int, str]:
    """Return exit code and standard error of a service; it prints nothing else."""
    done = subprocess.run(
        [sys.executable, "-m", "rpod", verb, "--config", file],
        capture_output=True,
        text=True,
        timeout=600.0,
        check=False,
    )
    assert done.stdout == ""
    return done.returncode, done.stderr


def the_line(verb: str, file: Path, code: int = 2) -> str:
    found, stderr = ended(verb, file)
    assert found == code, stderr
    *told, line = stderr.splitlines()
    assert all(" INFO " in each for each in told), stderr
    return line


def written(directory: Path, document: object) -> Path:
    file = directory / "bad.yaml"
    file.write_text(yaml.safe_dump(document), "utf-8")
    return file


@pytest.mark.parametrize(
    ("verb", "changes", "field", "reason"),
    [
        ("router", {"listen": "7447"}, "listen", "endpoint of Zenoh, such as tcp/127.0.0.1:7447"),
        ("motion", {"rate_hz": 0}, "rate_hz", "greater than 0"),
        ("motion", {"bus": 5}, "bus", "is 5; it must be a mapping"),
        ("emulator", {"sensors": [{"kind": "radar"}]}, "sensors.0.kind", "known are lidar, pmd"),
        (
            "emulator",
            {"sensors": [{"kind": "pmd", "T_chaser_sensor": {"translation_m": {"x": 1}}}]},
            "sensors.0.T_chaser_sensor",
            "it needs 3 finite numbers",
        ),
        ("estimator", {"sensors": []}, "sensors", "needs 1 at least"),
        ("estimator", {"filter": {"gate": 3}}, "filter.gate", "not a known field"),
        ("logger", {"directroy": "x"}, "directroy", "not a known field"),
    ],
)
def test_a_wrong_field_is_named_with_its_file_and_the_reason(tmp_path, verb, changes, field, reason):
    file = written(tmp_path, GOOD[verb] | changes)
    refused = CliRunner().invoke(app, [verb, "--config", str(file)])
    assert (refused.exit_code, refused.stdout) == (2, "")
    (line,) = refused.stderr.splitlines()
    assert line.startswith(f"rpod {verb}: {file}: {field}: ")
    assert reason in line


def test_an_unknown_target_is_named_with_those_that_are_known(tmp_path):
    file = written(tmp_path, GOOD["motion"] | {"target": "mockpu"})
    line = the_line("motion", file)
    assert f"{file}: target: " in line
    assert "'mockpu'" in line
    assert "known are envisat-bulky" in line


def test_a_target_whose_mesh_is_missing_is_named_with_the_mesh(tmp_path):
    own = yaml.safe_load(Path(load_target("mockup").source).read_text("utf-8"))
    own["parts"][0] = {
        "shape": "mesh",
        "name": "hull",
        "file": "hull.stl",
        "material": next(iter(own["materials"])),
        "metres_per_unit": 1.0,
    }
    target = tmp_path / "own.yaml"
    target.write_text(yaml.safe_dump(own), "utf-8")
    file = written(tmp_path, GOOD["estimator"] | {"target": str(target)})
    line = the_line("estimator", file)
    assert f"{file}: target: {target}: parts.0.file: " in line
    assert "hull.stl cannot be read (No such file or directory)" in line


def test_without_a_router_a_service_ends_with_one_line_that_says_what_to_do(tmp_path):
    bus = {"connect": free_endpoint(), "connect_timeout_s": 0.1}
    line = the_line("logger", written(tmp_path, {"bus": bus}), code=1)
    assert f"no router at {bus['connect']}" in line
    assert "rpod router" in line
