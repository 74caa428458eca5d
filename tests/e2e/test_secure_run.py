"""Three commands to a secure run: ``rpod pki init``, ``rpod pki issue all``, ``rpod run --secure``."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from facility_process import FacilityProcess

from rpod_security.audit import check

PKI = "pki"


def rpod(*arguments: str, folder: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "rpod", *arguments]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, timeout=120)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("secure")
    for command in (["pki", "init", "--pki", PKI], ["pki", "issue", "all", "--pki", PKI]):
        done = rpod(*command, folder=folder)
        assert done.returncode == 0, done.stderr
    return folder


@pytest.fixture(scope="module")
def finished(folder: Path):
    run = FacilityProcess(
        "mockup-tumbling",
        "--duration",
        "2",
        "--secure",
        "--pki",
        str(folder / PKI),
        "--json",
        out=folder / "runs",
    )
    try:
        yield run.finish()
    finally:
        run.close()


def test_a_secure_run_misses_nothing(finished):
    assert finished.code == 0, finished.stderr
    summary = finished.summary
    assert summary.completeness
    assert summary.completeness.complete
    assert sum(frames.missed for frames in summary.frames.values()) == 0
    assert summary.estimates.accepted > 0


def test_no_key_is_in_anything_that_a_run_leaves(finished, folder: Path):
    texts = [file.read_text() for file in (folder / PKI).rglob("*.pem")]
    secrets = [text.split("PRIVATE KEY-----")[1].split()[0] for text in texts if "PRIVATE KEY" in text]
    assert len(secrets) >= 8
    for file in finished.directory.rglob("*"):
        if file.is_file():
            content = file.read_bytes()
            assert b"PRIVATE KEY" not in content, file
            assert not [secret for secret in secrets if secret.encode() in content], file


def test_who_started_the_run_is_in_the_audit_record(finished, folder: Path):
    assert finished.code == 0
    record = folder / PKI / "motion" / "audit.jsonl"
    assert check(record) == 2
    line = json.loads(record.read_text().splitlines()[1])
    assert (line["role"], line["verb"], line["outcome"]) == ("supervisor", "start", "accepted")
    assert rpod("pki", "audit", str(record), folder=folder).returncode == 0


def test_a_run_without_certificates_says_which_commands_make_them(tmp_path: Path):
    done = rpod("run", "mockup-tumbling", "--secure", "--pki", "none", "--out", "runs", folder=tmp_path)
    assert done.returncode == 1
    assert "rpod pki init" in done.stderr
    assert "Traceback" not in done.stderr


def test_the_verbs_of_pki_tell_their_errors_in_one_line(folder: Path, tmp_path: Path):
    for arguments, text in (
        (["pki", "init", "--pki", PKI], "holds an authority already"),
        (["pki", "issue", "view", "view", "--pki", PKI], "is in use"),
        (["pki", "issue", "admin", "x", "--pki", PKI], "is unknown"),
        (["pki", "renew", "nobody", "--pki", PKI], "was never issued"),
        (["pki", "rules", "none.yaml", "--pki", PKI], "cannot be read"),
        (["pki", "show", "--pki", str(tmp_path)], "rpod pki init"),
    ):
        done = rpod(*arguments, folder=folder)
        assert done.returncode in (1, 2)
        assert text in done.stderr
        assert len(done.stderr.splitlines()) == 1


def test_a_name_goes_from_issue_over_rules_to_its_revocation(folder: Path):
    assert rpod("pki", "issue", "guidance", "arm", "--pki", PKI, folder=folder).returncode == 0
    (folder / "facility.yaml").write_text(
        "members:\n  arm: {role: guidance}\n  estimator: {role: estimator}\n"
    )
    assert (
        rpod("pki", "rules", "facility.yaml", "--pki", PKI, "--out", "r.json", folder=folder).returncode == 0
    )
    assert "arm.1" in (folder / "r.json").read_text()
    assert rpod("pki", "renew", "arm", "--pki", PKI, folder=folder).returncode == 0
    assert rpod("pki", "revoke", "arm", "--pki", PKI, folder=folder).returncode == 0
    again = rpod("pki", "rules", "facility.yaml", "--pki", PKI, folder=folder)
    assert "arm" not in json.dumps(json.loads(again.stdout)["subjects"])
    assert "arm has no valid certificate" in again.stderr
    shown = json.loads(rpod("pki", "show", "--json", "--pki", PKI, folder=folder).stdout)
    assert [entry["name"] for entry in shown["names"] if entry["revoked"]] == ["arm"]
