"""A method and a sensor kind from packages outside the project, with no line changed in it."""

import json
from pathlib import Path

import pytest
import yaml
from plugins import EXAMPLES, installed, with_packages

METHOD, KIND = "plugin_signed_distance", "plugin_mono_camera"
MOST_LINES, FILES = 60, 3


@pytest.fixture(scope="module")
def method(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return installed(METHOD, tmp_path_factory.mktemp("method"))


@pytest.fixture(scope="module")
def kind(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return installed(KIND, tmp_path_factory.mktemp("kind"))


def played(where: Path, scenario: Path, out: Path, *, duration_s: float) -> dict:
    options = ("--speed", "max", "--duration", str(duration_s), "--out", str(out), "--json")
    return json.loads(with_packages(where, "run", str(scenario), *options))


def test_a_method_is_three_files_of_at_most_60_lines_with_the_scenario_that_plays_it():
    files = [path for path in (EXAMPLES / METHOD).rglob("*") if path.suffix in (".py", ".toml")]
    assert len(files) == FILES
    written = [*files, EXAMPLES / METHOD / "my-run.yaml"]
    assert sum(len(path.read_text().splitlines()) for path in written) <= MOST_LINES


def test_a_copied_method_estimates_bit_for_bit_what_the_original_does(method: Path, tmp_path: Path):
    scenario = EXAMPLES / METHOD / "my-run.yaml"
    summary = played(method, scenario, tmp_path / "runs", duration_s=1.0)
    assert summary["modes"]["tracking_share"] == 1.0
    log = Path(summary["log"])
    config = json.loads((log.parent / "config" / "estimator.json").read_text())
    assert config["sensors"][0]["tracking"]["kind"] == "my_distance"
    config["sensors"][0]["tracking"]["kind"] = "signed_distance"
    original = tmp_path / "original.json"
    original.write_text(json.dumps(config))
    report = json.loads(with_packages(method, "replay", str(log), "--config", str(original), "--json"))
    difference = report["difference"]
    assert difference["identical"] == difference["common"] > 40, (difference, summary["inputs"])


def test_a_campaign_takes_the_method_by_its_name(method: Path, tmp_path: Path):
    options = ("--method", "my-distance", "--scenario", "tumbling", "--through", "tracker", "--jobs", "1")
    with_packages(method, "campaign", "pmd-tracking", *options, "--out", str(tmp_path))
    page = next(tmp_path.rglob("report.html")).read_text()
    assert "my-distance" in page


def test_the_tests_of_the_third_kind_pass(kind: Path):
    tests = str(EXAMPLES / KIND / "tests")
    options = ("-q", "-p", "no:cacheprovider", "--rootdir", tests, tests)
    with_packages(kind, *options, modules=("pytest",))


def test_a_third_kind_is_played_logged_reported_and_replayed(kind: Path, tmp_path: Path):
    document = yaml.safe_load((EXAMPLES / KIND / "mono-tumbling.yaml").read_text())
    document["motion"]["trajectory"]["end_m"] = [0, 0, 6.4]  # as fast as in the whole scenario
    scenario = tmp_path / "mono-tumbling.yaml"
    scenario.write_text(yaml.safe_dump(document))
    summary = played(kind, scenario, tmp_path / "runs", duration_s=3.0)
    for topic in ("mono/image_raw", "mono/camera_info"):
        assert summary["frames"][topic] == {"published": 30, "logged": 30, "missed": 0}
    assert summary["completeness"]["reasons"] == []
    assert summary["completeness"]["complete"]
    # frames may be refused until the twist is known
    assert summary["estimates"]["accepted"] >= 27
    assert summary["modes"]["tracking_share"] > 0.9
    assert summary["error"]["attitude_deg"]["rms"] < 0.5
    assert summary["error"]["position_m"]["rms"] < 0.05
    log = Path(summary["log"])
    assert "mono" in (log.parent / "report.html").read_text()
    report = json.loads(with_packages(kind, "replay", str(log), "--json"))
    assert report["difference"]["identical"] == report["difference"]["common"] >= 27


def test_without_the_package_an_error_names_the_kind_and_the_remedy(tmp_path: Path):
    scenario = EXAMPLES / KIND / "mono-tumbling.yaml"
    with pytest.raises(AssertionError, match=r"sensors\.0\.kind: no installed package provides 'mono'"):
        played(tmp_path, scenario, tmp_path / "runs", duration_s=1.0)
