"""Three commands to a secure run: ``rpod pki init``, ``rpod pki issue all``, ``rpod run --secure``."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from facility_process import FacilityProcess

from rpod.scenarios import find
from rpod_analysis.log import open_log
from rpod_schemas.config.scenario import Scenario
from rpod_schemas.topics import DIAGNOSTICS
from rpod_security.audit import check

PKI = "pki"
FAULT = {"fault": "link_delay", "service": "estimator", "size": 0.02, "start_s": 0.5, "duration_s": 1.0}


def rpod(*arguments: str, folder: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "rpod", *arguments]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, timeout=600)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("secure")
    for command in (["pki", "init", "--pki", PKI], ["pki", "issue", "all", "--pki", PKI]):
        done = rpod(*command, folder=folder)
        assert done.returncode == 0, done.stderr
    return folder


@pytest.fixture(scope="module")
def finished(folder: Path):
    scenario = folder / "delayed.json"
    document = dict(find("mockup-tumbling")) | {"name": "delayed", "faults": [FAULT]}
    scenario.write_text(Scenario.model_validate(document).model_dump_json(), "utf-8")
    run = FacilityProcess(
        str(scenario),
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
    assert summary.completeness.reasons == ()
    assert summary.completeness.complete
    assert sum(frames.missed for frames in summary.frames.values()) == 0
    assert summary.estimates.count + summary.estimates.rejected > 0, (
        "how many are right depends on the machine"
    )


def test_a_fault_of_a_link_is_injected_into_its_encrypted_bytes(finished):
    (fault,) = finished.summary.faults
    assert (fault.fault, fault.where, fault.size) == ("link_delay", "estimator", 0.02)
    with open_log(finished.log) as log:
        statuses = [status for logged in log.messages(DIAGNOSTICS) for status in logged.decode().status]
    passed = [
        int(value.value)
        for status in statuses
        if status.name == "proxy"
        for value in status.values
        if value.key == "passed_bytes/estimator"
    ]
    assert max(passed) > 100_000, "its images"


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


def test_a_run_without_certificates_says_which_commands_make_them(tmp_path: Path):
    done = rpod("run", "mockup-tumbling", "--secure", "--pki", "none", "--out", "runs", folder=tmp_path)
    assert done.returncode == 1
    assert "rpod pki init" in done.stderr
    assert "Traceback" not in done.stderr
