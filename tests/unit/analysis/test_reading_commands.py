"""``rpod recover`` and ``rpod replay`` from arguments to output and exit code."""

import json
from pathlib import Path

import pytest
from synthetic_log import T_CHASER_SENSOR, SyntheticRun, approach, see_depth
from typer.testing import CliRunner

from rpod.__main__ import app
from rpod_schemas.config.estimator import EstimatorConfig, PmdInput
from rpod_schemas.logs import Recovery
from rpod_schemas.replay import ReplayReport
from rpod_schemas.types import Camera
from rpod_target import load_target

CAMERA = Camera(width=88, height=72, fx=170.0, fy=170.0, cx=43.5, cy=35.5)


def rpod(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def the_line(refused, code):
    assert refused.exit_code == code
    assert not refused.stdout
    (line,) = refused.stderr.splitlines()
    return line


@pytest.mark.parametrize("content", [None, b"", b"text, no log"], ids=["missing", "empty", "no MCAP"])
@pytest.mark.parametrize("verb", [("recover",), ("replay",), ("replay", "--bus")])
def test_what_is_no_log_is_refused_in_one_line(tmp_path, verb, content):
    log = tmp_path / "run.mcap"
    if content is not None:
        log.write_bytes(content)
    assert str(log) in the_line(rpod(*verb, log), 1)
    assert list(tmp_path.iterdir()) == ([] if content is None else [log])


@pytest.mark.parametrize(
    ("options", "field"),
    [
        (("--bus", "--speed", "0"), "--speed"),
        (("--from", "3", "--to", "2"), "--to"),
        (("--connect", "nowhere"), "connect"),
        (("--config", "gone.yaml"), "gone.yaml"),
    ],
)
def test_a_bad_option_is_refused_with_field_and_reason(tmp_path, options, field):
    log = SyntheticRun(duration_s=0.1).write(tmp_path / "run.mcap")
    line = the_line(rpod("replay", log, *options), 2)
    assert f"{field}: " in line
    assert line.count("rpod replay") == 1


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--loop",), "--loop: needs --bus; without it the log is replayed once through the estimator"),
        (("--speed", "1"), "--speed: needs --bus; "),
        (("--topics", "pmd/*"), "--topics: needs --bus; "),
        (("--no-clock",), "--no-clock: needs --bus; "),
        (("--bus", "--config", "gone.yaml"), "--config: is for a replay through the estimator"),
        (("--connect", "tcp/127.0.0.1:1", "--out", "o.mcap"), "--out: is for a replay through the estimator"),
        (("--bus", "--as-live"), "--as-live: is for a replay through the estimator"),
    ],
)
def test_an_option_without_effect_is_refused(tmp_path, options, words):
    assert f"rpod replay: {words}" in the_line(rpod("replay", tmp_path / "run.mcap", *options), 2)


@pytest.mark.parametrize("clock", [True, False])
def test_a_beginning_after_the_end_of_the_log_is_told(tmp_path, clock):
    log = SyntheticRun(duration_s=0.5, clock=clock).write(tmp_path / "run.mcap")
    config = tmp_path / "estimator.json"
    config.write_text('{"target": "mockup", "sensors": [{"kind": "pmd"}]}', "utf-8")
    line = the_line(rpod("replay", log, "--config", config, "--from", "500"), 1)
    assert "s, before --from 500; give an earlier time" in line
    assert sorted(tmp_path.iterdir()) == [config, log]


def test_a_configuration_that_is_not_whole_is_refused(tmp_path):
    log = SyntheticRun(duration_s=0.1).write(tmp_path / "run.mcap")
    assert "no configuration of an estimator" in the_line(rpod("replay", log), 1)


def test_a_cut_log_is_recovered_and_told_as_a_table_or_json(tmp_path):
    log = SyntheticRun(duration_s=0.5).write(tmp_path / "run.mcap")
    log.write_bytes(log.read_bytes()[:-800])
    assert "rpod recover" in the_line(rpod("replay", log), 1)
    recovery = Recovery.model_validate_json(rpod("recover", log, "--json").stdout)
    assert recovery.topics["/truth/odometry"].messages == 130
    assert not recovery.closed
    shown = rpod("recover", log, "--out", tmp_path / "other.mcap")
    assert "The end of the file is missing" in shown.stdout
    assert "/truth/odometry" in shown.stdout
    assert "already exists" in the_line(rpod("recover", log), 1)


def test_a_replay_is_told_as_a_table_or_json(tmp_path):
    run = SyntheticRun(
        duration_s=0.3, camera=CAMERA, target="mockup", render=see_depth(load_target("mockup"), CAMERA)
    )
    log, config = run.write(tmp_path / "run.mcap"), tmp_path / "estimator.json"
    model = EstimatorConfig(
        target="mockup", sensors=(PmdInput(),), initial_pose=T_CHASER_SENSOR * approach(0.0)
    )
    config.write_text(json.dumps(model.model_dump(mode="json")), "utf-8")
    report = ReplayReport.model_validate_json(rpod("replay", log, "--config", config, "--json").stdout)
    assert (report.frames, report.new.frames, report.old.estimates) == (4, 4, 4)
    assert (Path(report.out), report.replaced) == (tmp_path / "run.replay.mcap", False)
    shown = rpod("replay", log, "--config", config, "--as-live").stdout
    assert "4 frames replayed" in shown
    assert "An older file was replaced" in shown
    assert "common poses are identical" in shown
