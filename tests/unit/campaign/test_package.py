"""What holds of the package's files, whatever they do."""

import ast
import sys
from pathlib import Path
from types import ModuleType

import pytest

import rpod_campaign
from rpod_campaign.catalogue import BUILT_IN, find, options_of
from rpod_campaign.engine import software
from rpod_campaign.engine.software import _all_sources

ROOT = Path(rpod_campaign.__file__).parent
FOLDERS = sorted({file.parent for file in ROOT.rglob("*.py")}, key=str)


def imports(file: Path) -> set[str]:
    """Return the modules of this package that a file imports."""
    tree = ast.parse(file.read_text("utf-8"))
    named = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.module}
    return {name for name in named if name.startswith("rpod_campaign.")}


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)
def test_no_folder_has_more_than_fifteen_modules(folder):
    assert len([file for file in folder.glob("*.py") if file.stem != "__init__"]) <= 15


@pytest.mark.parametrize("name", BUILT_IN)
def test_a_campaign_has_a_folder_with_options_trial_and_report(name):
    folder = ROOT / name.replace("-", "_")
    assert {"options.py", "trial.py", "report.py", "campaign.py"} <= {file.name for file in folder.iterdir()}
    assert find(name).name == name
    assert find(name).options is options_of(name)


@pytest.mark.parametrize("name", BUILT_IN)
def test_all_that_a_trial_imports_of_this_package_counts_for_its_digest(name):
    sources = _all_sources(find(name).trial.__module__)
    counted = {source.removesuffix(".py").replace("/", ".") for source, _ in sources}
    reached, left = set(), {find(name).trial.__module__}
    while left:
        module = left.pop()
        file = ROOT.parent / f"{module.replace('.', '/')}.py"
        reached.add(module)
        if file.exists():
            left |= imports(file) - reached
    assert reached <= counted | {"rpod_campaign.lidar.options", "rpod_campaign.pmd.options"}


def test_a_package_that_provides_a_method_counts_for_the_digest(monkeypatch):
    trial = find("pmd-tracking").trial.__module__
    assert "counting_campaign" not in dict(_all_sources(trial))
    monkeypatch.setattr(software, "providers", lambda: ("rpod_schemas", "counting_campaign"))
    assert dict(_all_sources(trial))["counting_campaign"].name == "counting_campaign.py"


def test_only_this_packages_options_and_reports_are_left_out_of_the_digest():
    names = dict(_all_sources(find("pmd-tracking").trial.__module__))
    assert "rpod_pose/navigation/dynamics/options.py" in names
    assert not {"rpod_campaign.pmd/options.py", "rpod_campaign.pmd/report/tables.py"} & set(names)


def test_a_trial_of_a_campaign_beside_a_shared_folder_counts_for_the_digest(monkeypatch):
    module = ModuleType("rpod_campaign.lidar_other")
    module.cell = find("lidar-range").trial
    monkeypatch.setitem(sys.modules, module.__name__, module)
    modules, _ = software._trials(module.__name__)
    assert "rpod_campaign.lidar_range.trial" in modules


def test_the_engine_knows_no_campaign_and_no_sensor():
    for file in (ROOT / "engine").rglob("*.py"):
        others = {name for name in imports(file) if not name.startswith("rpod_campaign.engine")}
        assert others <= {"rpod_campaign.catalogue"}, file
