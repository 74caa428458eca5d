"""The systemd units: what systemd would read in them, whose commands these are, and who may read a key."""

import os
import shutil
import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from typer.main import get_command

from rpod.__main__ import app
from rpod_security.authority import Authority
from rpod_security.credentials import IDENTITY

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


# ---- users


def service_of(unit):
    """Return the name of a unit's service, which is that of its folder of credentials."""
    return "%i" if "@" in unit.stem else unit.stem.removeprefix("rpod-")


@pytest.mark.parametrize("unit", SERVICES, ids=lambda unit: unit.stem)
def test_it_has_a_user_a_cache_and_a_folder_of_credentials_that_no_other_unit_has(unit):
    service, name = read(unit)["Service"], service_of(unit)
    assert service["User"] == [f"rpod-{name}"]
    assert "Group" not in service, "the user's own"
    assert "SupplementaryGroups" not in service
    assert service["ReadWritePaths"] == [f"-/etc/rpod/credentials/{name}"]
    assert service["CacheDirectory"] == [f"rpod-{name}"]
    cache = f"/var/cache/rpod-{name}"
    assert service["Environment"] == [f"RPOD_CACHE={cache} NUMBA_CACHE_DIR={cache}/numba"]
    assert service["UMask"] == ["0077"]


def test_the_users_of_all_units_are_declared():
    lines = (UNITS / "rpod.sysusers.conf").read_text("utf-8").splitlines()
    declared = {line.split()[1] for line in lines if line and line[0] != "#"}
    assert declared == {f"rpod-{service_of(unit)}" for unit in SERVICES} - {"rpod-%i"}


@pytest.mark.skipif(shutil.which("systemd-sysusers") is None, reason="systemd-sysusers is not installed")
def test_systemd_makes_the_users(tmp_path):
    (tmp_path / "etc").mkdir()
    command = ["systemd-sysusers", f"--root={tmp_path}", UNITS / "rpod.sysusers.conf"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr.count("not a valid")) == (0, 0), done.stderr
    made = (tmp_path / "etc" / "passwd").read_text("utf-8")
    assert all(f"rpod-{name}:" in made for name in ("router", "logger", "estimator", "motion"))


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can act as other users")
def test_the_user_of_one_service_cannot_read_or_list_the_credentials_of_another_one():
    def can(user, *command):
        done = subprocess.run(
            command, user=user, group=user, extra_groups=(), capture_output=True, text=True, check=False
        )
        assert done.returncode == 0 or "Permission denied" in done.stderr, done.stderr
        return done.returncode == 0

    users = {"logger": 60_001, "estimator": 60_002}
    with TemporaryDirectory() as folder:  # those of pytest are closed to other users
        pki = Path(folder)
        pki.chmod(0o755)
        authority = Authority.create(pki)
        for name, user in users.items():
            issued = authority.issue(name, name)
            for path in (issued, *issued.iterdir()):
                os.chown(path, user, user)
        for name, user in users.items():
            for other in users:
                assert can(user, "cat", pki / other / IDENTITY) == (name == other)
                assert can(user, "ls", pki / other) == (name == other)
            assert not can(user, "cat", pki / "authority" / "key.pem")


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed")
def test_systemd_rates_every_unit_as_safe():
    command = ["systemd-analyze", "security", "--offline=true", "--threshold=30", *map(str, SERVICES)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr
