"""The command line as an operator meets it: what it offers, and what it says of bad usage."""

import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from command_line import called

from rpod.play.facility import configure
from rpod.scenarios import find, shipped

SCENARIOS = {
    "mockup-tumbling",
    "mockup-oblique",
    "mockup-approach",
    "mockup-calibration",
    "mockup-handover",
    "mockup-mounts",
    "envisat-station",
    "envisat-mesh",
    "envisat-capture",
}
VERBS = {"run", "router", "motion", "emulator", "estimator", "logger", "scenarios", "report", "calibrate"} | {
    "recover",
    "replay",
}


def rpod(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "rpod", *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )


def the_line(refused: subprocess.CompletedProcess[str], code: int) -> str:
    """Return what a refusal says: one line, and nothing on standard output."""
    assert refused.returncode == code, refused.stderr
    assert not refused.stdout
    (line,) = refused.stderr.splitlines()
    return line


def test_help_lists_the_verbs():
    shown = rpod("--help")
    assert shown.returncode == 0
    assert set(shown.stdout.split()) >= VERBS


def test_scenarios_lists_what_ships_with_one_line_each():
    shown = rpod("scenarios")
    assert shown.returncode == 0
    lines = dict(line.split(maxsplit=1) for line in shown.stdout.splitlines())
    assert set(lines) == SCENARIOS
    assert all(lines[name].strip() == find(name).title for name in SCENARIOS)


@pytest.mark.parametrize("name", sorted(SCENARIOS))
@pytest.mark.parametrize("speed", ["1", "max"])
def test_every_scenario_that_ships_configures_all_services(name, speed, tmp_path):
    scenario = find(name)
    assert scenario.name == name == shipped()[name].stem
    facility = configure(scenario, directory=tmp_path, speed=speed)
    assert set(facility.services) == {"motion", "emulator", "estimator", "logger"}


@pytest.mark.parametrize("asked", [False, True])
def test_a_scenario_may_ask_for_the_raw_samples(asked, tmp_path):
    scenario = find("mockup-approach").model_copy(update={"publish_samples": asked})
    assert configure(scenario, directory=tmp_path, speed="1").services["emulator"].publish_samples is asked


def test_an_unknown_scenario_is_refused_with_the_known_ones(tmp_path):
    line = the_line(called("run", "mockup-tumblin", "--out", tmp_path), 2)
    assert "'mockup-tumblin'" in line or "mockup-tumblin:" in line
    assert all(name in line for name in SCENARIOS)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (
            lambda document: document["motion"]["attitude"].update(rate_rpm=3),
            ("mine.yaml: motion.attitude.", "rate_rpm: ", "not a known field"),
        ),
        (lambda document: document.update(target="iss"), ("target 'iss': is unknown", "mockup")),
    ],
    ids=["unknown field", "unknown target"],
)
def test_a_bad_scenario_file_is_refused_with_what_is_wrong_in_it(tmp_path, spoil, says):
    document = yaml.safe_load(shipped()["mockup-tumbling"].read_text("utf-8"))
    spoil(document)
    file = tmp_path / "mine.yaml"
    file.write_text(yaml.safe_dump(document), "utf-8")
    line = the_line(called("run", file, "--out", tmp_path / "runs"), 2)
    assert all(part in line for part in says)
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize(
    ("option", "value", "field"), [("--speed", "3", "--speed"), ("--duration", "0", "duration_s")]
)
def test_a_bad_option_is_refused_with_field_and_reason(tmp_path, option, value, field):
    line = the_line(called("run", "mockup-tumbling", option, value, "--out", tmp_path), 2)
    assert f"{field}: " in line
    assert not list(tmp_path.iterdir())


def test_a_service_refuses_a_bad_configuration_in_one_line(tmp_path):
    file = tmp_path / "logger.json"
    file.write_text('{"chunk_bytes": 1}', "utf-8")
    line = the_line(called("logger", "--config", file), 2)
    assert "logger.json: chunk_bytes: " in line


@pytest.mark.parametrize("content", [None, b"", b"text, no log"], ids=["missing", "empty", "no MCAP"])
def test_a_report_of_what_is_no_log_fails_in_one_line(tmp_path, content):
    log = tmp_path / "run.mcap"
    if content is not None:
        log.write_bytes(content)
    assert str(log) in the_line(called("report", log), 1)
    assert not (tmp_path / "report.html").exists()


def test_a_run_that_cannot_make_its_folder_fails_in_one_line(tmp_path):
    file = tmp_path / "file"
    file.touch()
    assert str(file) in the_line(called("run", "mockup-tumbling", "--out", file / "runs"), 1)
