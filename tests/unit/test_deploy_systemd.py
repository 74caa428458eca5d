"""The systemd units: what systemd would read in them, and that each command is one of rpod's."""

from pathlib import Path

import pytest
from typer.main import get_command

from rpod.__main__ import app

UNITS = Path(__file__).parents[2] / "deploy" / "systemd"
SERVICES = sorted(UNITS.glob("*.service"))


def read(unit):
    """Return the entries of a unit by section; systemd.syntax(7) allows a key more than once."""
    sections, entries = {}, None
    for line in unit.read_text("utf-8").splitlines():
        if not line or line[0] in "#;":
            continue
        if line.startswith("["):
            entries = sections.setdefault(line.strip("[]"), {})
            continue
        assert "=" in line, line
        key, value = line.split("=", 1)
        entries.setdefault(key, []).append(value)
    return sections


@pytest.fixture(params=SERVICES, ids=lambda unit: unit.stem)
def unit(request):
    return read(request.param)


def test_its_command_is_one_of_rpod_s_and_its_configuration_is_in_etc(unit):
    program, verb, *rest = unit["Service"]["ExecStart"][0].split()
    assert program == "/opt/rpod/bin/rpod"
    command = get_command(app).commands[verb]
    if verb == "driver":
        assert rest == ["run", "$DRIVER", "/etc/rpod/%i.yaml"]
        assert [each.name for each in command.commands["run"].params][:2] == ["name", "config"]
    else:
        assert rest == ["--config", f"/etc/rpod/{verb}.yaml"]
        assert "--config" in {option for each in command.params for option in each.opts}


def test_it_is_started_when_it_is_warm_and_watched_limited_and_started_again(unit):
    service = unit["Service"]
    assert service["Type"] == ["notify"]
    assert service["NotifyAccess"] == ["main"]
    assert int(service["WatchdogSec"][0]) >= 30
    assert service["Restart"][0] in ("always", "on-failure")
    assert service["RestartPreventExitStatus"] == ["2"]
    assert unit["Unit"]["StartLimitIntervalSec"] == ["0"]
    assert {"MemoryMax", "CPUQuota", "TasksMax", "LimitNOFILE"} <= set(service)


def test_it_belongs_to_the_target_and_is_after_the_router(unit):
    assert unit["Unit"]["PartOf"] == ["rpod.target"]
    assert unit["Install"]["WantedBy"] == ["rpod.target"]
    if "router" not in unit["Service"]["ExecStart"][0]:
        assert "rpod-router.service" in unit["Unit"]["After"][0].split()


def test_kernels_may_be_compiled_and_nothing_else_is_allowed_that_the_others_are_denied(unit):
    service = unit["Service"]
    assert "MemoryDenyWriteExecute" not in service
    assert service["NoNewPrivileges"] == ["yes"]
    assert service["CapabilityBoundingSet"] == [""]
    assert service["ProtectSystem"] == ["strict"]


def test_the_target_is_there_and_every_service_of_the_command_line_has_a_unit():
    assert read(UNITS / "rpod.target")["Install"]["WantedBy"] == ["multi-user.target"]
    verbs = {read(unit)["Service"]["ExecStart"][0].split()[1] for unit in SERVICES}
    assert verbs == {"router", "logger", "estimator", "emulator", "motion", "proxy", "driver"}
