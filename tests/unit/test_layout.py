import ast
import re
import tomllib
from pathlib import Path

import pytest
from hatchling.builders.wheel import WheelBuilder

ROOT = Path(__file__).parents[2]
FOLDERS = ("schemas", "services", "sim_sensor")
SOURCES = sorted(file for folder in FOLDERS for file in (ROOT / folder).rglob("*.py"))

COMPILED_ELSEWHERE = ("rpod_geometry/kernels.py",)
"""The decorator itself."""

CROWDED = 15
"""Most modules of a folder in which a reader still finds a file."""
ROOMS = sorted({file.parent for file in SOURCES})
LONG_FUNCTION = 50
"""Most lines of a function, without its docstring."""
LONG = 400
"""Most lines of a module that a reader still surveys."""
NO_CODE = {"rpod_msgs"}
"""Definitions of messages, which import nothing."""


@pytest.mark.parametrize("folder", ROOMS, ids=lambda folder: str(folder.relative_to(ROOT)))
def test_no_folder_is_crowded(folder):
    assert len(list(folder.glob("*.py"))) <= CROWDED


def _code_lines(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Return the number of a function's lines without its docstring."""
    first = function.body[0]
    told = first.end_lineno - first.lineno + 1 if ast.get_docstring(function) else 0
    return function.end_lineno - function.lineno + 1 - told


def test_no_function_is_long():
    lines = {
        f"{file.relative_to(ROOT)}: {node.name}": _code_lines(node)
        for file in SOURCES
        for node in ast.walk(ast.parse(file.read_text("utf-8")))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
    }
    assert not {name: number for name, number in lines.items() if number > LONG_FUNCTION}


def test_every_module_is_in_the_wheel():
    held = {file.distribution_path for file in WheelBuilder(str(ROOT)).recurse_included_files()}
    paths = {
        str(file.relative_to(ROOT / folder)) for folder in FOLDERS for file in (ROOT / folder).rglob("*.py")
    }
    assert paths - held == set()


def test_no_module_is_long():
    lines = {str(file.relative_to(ROOT)): file.read_text("utf-8").count("\n") for file in SOURCES}
    assert not {name: number for name, number in lines.items() if number > LONG}


def test_every_package_stands_in_the_contract_of_layers():
    """Import-linter checks only the packages that are named; a new one must not be left out."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["importlinter"]
    inits = [file for file in SOURCES if file.name == "__init__.py"]
    packages = {file.parent.name for file in inits if file.parents[1].name in FOLDERS} - NO_CODE
    assert len(packages) >= 17
    assert set(settings["root_packages"]) == packages
    layers = settings["contracts"][0]["layers"]
    assert sorted(name.strip() for layer in layers for name in layer.split("|")) == sorted(packages)


@pytest.mark.parametrize("folder", FOLDERS)
def test_only_prefixed_packages_and_documents_stand_in_a_source_folder(folder):
    for child in (ROOT / folder).iterdir():
        if child.name == "__pycache__":
            continue
        assert (child.is_dir() and child.name.startswith("rpod")) or child.suffix == ".md", child


def test_kernels_are_compiled_in_one_way():
    """Cached, without the interpreter's lock, on one thread: ``rpod_geometry.kernels`` says it once."""
    others = [
        file
        for file in SOURCES
        if "njit(" in file.read_text("utf-8") and not file.as_posix().endswith(COMPILED_ELSEWHERE)
    ]
    assert not others, others


def test_no_console_takes_brackets_of_a_path_for_markup():
    sources = "\n".join(file.read_text("utf-8") for file in SOURCES)
    consoles = re.findall(r"(?<!\w)Console\(.*", sources)
    assert consoles
    assert [line for line in consoles if "markup=False" not in line] == []


@pytest.mark.parametrize("file", SOURCES, ids=lambda file: str(file.relative_to(ROOT)))
def test_no_module_is_a_drawer_for_odds_and_ends(file):
    assert file.stem not in ("utils", "helpers", "common", "misc", "util", "helper")


FILE_TABLES = [
    file for file in ROOT.glob("services/*/README.md") if "| file | holds |" in file.read_text("utf-8")
]


@pytest.mark.parametrize("readme", FILE_TABLES, ids=lambda file: file.parent.name)
def test_the_table_of_files_in_a_readme_names_each_module_of_its_package_and_no_other(readme):
    table = readme.read_text("utf-8").split("| file | holds |", 1)[1].split("\n\n", 1)[0]
    firsts = [row.strip("| ").split(" | ", 1)[0] for row in table.splitlines()]
    named = {name for first in firsts for name in re.findall(r"`(\w+\.py)`", first)}
    told_elsewhere = {"__init__.py", "__main__.py", "errors.py"}
    modules = {file.name for file in readme.parent.glob("*.py")}
    assert named - told_elsewhere == modules - told_elsewhere
