"""``rpod pki`` as its user sees it: files, lines, exit codes."""

import json
from ipaddress import ip_address
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from rpod.__main__ import app
from rpod.play.secure_run import _identity
from rpod_schemas.config.base import check as check_config
from rpod_schemas.config.facility.view import ViewConfig
from rpod_schemas.config.service import BusConfig, RouterConfig
from rpod_schemas.errors import ConfigurationError
from rpod_security.audit import AuditRecord
from rpod_security.errors import CredentialsError


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    assert pki("init", "--host", "lab-router").exit_code == 0
    return tmp_path


def pki(*arguments: str) -> Result:
    return CliRunner().invoke(app, ["pki", *arguments])


def test_all_credentials_of_a_run_are_issued_by_one_command(folder: Path):
    assert pki("issue", "all").exit_code == 0
    assert pki("issue", "all").exit_code == 0, "what is there is left alone"
    names = {entry.name for entry in (folder / "pki").iterdir()}
    run = {"motion", "emulator", "estimator", "logger", "view", "proxy", "supervisor"}
    assert names == run | {"router", "authority"}


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["init"], "holds an authority already"),
        (["issue", "router", "router"], "is in use"),
        (["issue", "admin", "x"], "is unknown"),
        (["issue", "view", "a/b"], "is not allowed"),
        (["renew", "nobody"], "was never issued"),
        (["revoke", "nobody"], "was never issued"),
        (["rules", "none.yaml"], "cannot be read"),
        (["show", "--pki", "elsewhere"], "'rpod pki init'; or name the folder of an existing one with --pki"),
        (["audit", "none.jsonl"], "rpod pki: none.jsonl: No such file"),
        (["sign", "none"], "rpod pki: none: No such file"),
        (["init", "--pki", "new", "--host", "lab router"], "--host: is 'lab router'; needs the name"),
        (["init", "--pki", "new", "--host", "10.0.0.1:7447"], "without a port"),
    ],
)
def test_an_error_is_one_line_with_the_remedy(folder: Path, arguments: list[str], text: str):
    done = pki(*arguments)
    assert folder
    assert done.exit_code in (1, 2)
    assert text in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert not (folder / "new").exists()


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["issue", "foo", "bar"], "role: 'foo' is unknown; choose all, or one of chaser, driver"),
        (["issue", "driver", "a", "--host", "x"], "--host: is only for the role router"),
        (["issue", "all", "a"], "name: is 'a'; 'all' gives each name itself"),
        (["request", "foo", "bar"], "role: 'foo' is unknown; choose one of chaser, driver"),
    ],
)
def test_bad_usage_has_its_own_exit_code_and_is_told_before_files_are_read(
    tmp_path: Path, arguments: list[str], text: str
):
    done = pki(*arguments, *(["--pki", str(tmp_path)] if arguments[0] == "issue" else []))
    assert done.exit_code == 2
    assert done.stderr.startswith(f"rpod pki: {text}")


def test_a_run_without_credentials_names_the_file_once_and_both_commands(tmp_path: Path):
    with pytest.raises(CredentialsError) as error:
        _identity(tmp_path / "motion")
    assert str(error.value) == (
        f"{tmp_path}/motion: identity.pem is missing; run 'rpod pki init', then 'rpod pki issue all', which "
        "issues what is missing"
    )


@pytest.mark.usefixtures("folder")
def test_rules_without_a_file_are_those_of_a_run():
    assert pki("issue", "all").exit_code == 0
    done = pki("rules")
    assert done.exit_code == 0, done.output
    assert {"emulator.1", "estimator.1"} <= {
        name for subject in json.loads(done.stdout)["subjects"] for name in subject["cert_common_names"]
    }
    assert "pmd/depth/image_raw" in done.stdout


def test_a_name_goes_from_issue_over_rules_to_its_revocation(folder: Path):
    assert pki("issue", "guidance", "arm").exit_code == 0
    members = folder / "facility.yaml"
    members.write_text("members:\n  arm: {role: guidance}\n  estimator: {role: estimator}\n")
    assert pki("rules", "facility.yaml", "--out", "rules.json").exit_code == 0
    assert "arm.1" in (folder / "rules.json").read_text()
    assert pki("renew", "arm").exit_code == 0
    assert pki("revoke", "arm").exit_code == 0
    again = pki("rules", "facility.yaml")
    assert json.loads(again.stdout)["subjects"] == []
    assert "arm has no valid certificate" in again.stderr
    assert pki("issue", "guidance", "arm").exit_code == 0
    assert "arm.2" in pki("rules", "facility.yaml").stdout
    shown = json.loads(pki("show", "--json").stdout)
    assert [entry["name"] for entry in shown["names"]] == ["arm", "router"]
    assert "arm.2" in pki("show").stdout


def test_what_ends_soon_is_renewed_without_naming_it(folder: Path):
    assert pki("issue", "view", "soon", "--days", "10").exit_code == 0
    assert pki("issue", "view", "later").exit_code == 0
    assert pki("renew").stdout.count("renewed") == 1
    assert folder


def test_no_verb_prints_a_key(folder: Path):
    printed = [pki("issue", "all"), pki("show"), pki("show", "--json"), pki("rules"), pki("renew", "motion")]
    keys = [
        file.read_text().split("PRIVATE KEY-----")[1].split()[0]
        for file in (folder / "pki").rglob("identity.pem")
    ]
    for each in printed:
        assert not [key for key in keys if key in each.output]
        assert "PRIVATE" not in each.output


def test_an_audit_record_is_checked(folder: Path):
    AuditRecord(folder / "audit.jsonl", "logger").add(
        role="console", verb="stop", request="", outcome="asked"
    )
    assert "1 lines" in pki("audit", "audit.jsonl").stdout


@pytest.mark.parametrize(
    ("model", "document", "field"),
    [
        (BusConfig, {"credentials": "x"}, "tls/127.0.0.1:7447"),
        (BusConfig, {"connect": "tls/a:1"}, "needs credentials"),
        (RouterConfig, {"listen": "tls/a:1", "credentials": "x"}, "rpod pki rules"),
        (RouterConfig, {"rules": "x"}, "rpod pki rules"),
        (
            ViewConfig,
            {"bind": ip_address("0.0.0.0"), "bus": {"connect": "tls/a:1", "credentials": "x"}},  # noqa: S104
            "SSH tunnel",
        ),
    ],
)
def test_a_half_secure_configuration_is_refused(model, document, field: str):
    with pytest.raises(ConfigurationError, match=field):
        check_config(model, document, source="test")
