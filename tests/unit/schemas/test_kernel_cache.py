"""A kernel is compiled anew when what it takes from other modules has changed, and only then."""

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
ROOMS = [ROOT / name for name in ("schemas", "services", "sim_sensor")]

INIT = """
from rpod_schemas.caches.kernels import watch_callees

watch_callees()
"""
KERNEL = """
from numba import njit

from rpod_tiny import beside, numbers
from rpod_tiny.between import twice
from rpod_tiny.numbers import OFFSET, Place


@njit(cache=True)
def result(x):
    return _inner(Place(x, 1.0)) + OFFSET


@njit(cache=True)
def _inner(place):
    return twice(place.x) + beside.shift(place.y) + numbers.STEP
"""
BETWEEN = """
from numba import njit

from rpod_tiny.far import factor


@njit(cache=True)
def twice(x):
    return factor() * x
"""
FAR = """
from numba import njit


@njit(cache=True)
def factor():
    return 2.0
"""
BESIDE = """
from numba import njit


@njit(cache=True)
def shift(y):
    return y - 1.0
"""
NUMBERS = """
from typing import NamedTuple

OFFSET = 0.0
STEP = 0.0


class Place(NamedTuple):
    x: float
    y: float
"""
SHELL = "NAME = 'not compiled'\n"
RUN = "from rpod_tiny import kernel; print(kernel.result(3.0), *kernel.result.stats.cache_hits.values())"


@pytest.fixture
def package(tmp_path):
    folder = tmp_path / "rpod_tiny"
    folder.mkdir()
    for name, text in {
        "__init__": INIT, "kernel": KERNEL, "between": BETWEEN, "far": FAR, "beside": BESIDE,
        "numbers": NUMBERS, "shell": SHELL,
    }.items():  # fmt: skip
        (folder / f"{name}.py").write_text(text)
    return folder


def run(package, **environment):
    path = os.pathsep.join([str(package.parent), *map(str, ROOMS)])
    finished = subprocess.run(
        [sys.executable, "-c", RUN],
        env={**os.environ, "PYTHONPATH": path, **environment},
        capture_output=True,
        text=True,
        check=False,
    )
    assert finished.returncode == 0, finished.stderr
    value, *hits = finished.stdout.split()
    return float(value), bool(hits)


def change(package, module, old, new):
    file = package / f"{module}.py"
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new))


def test_a_change_is_seen_wherever_it_is_and_what_has_not_changed_is_not_compiled_again(package):
    assert run(package) == (6.0, False)
    change(package, "shell", "not", "never")
    assert run(package) == (6.0, True)
    change(package, "far", "2.0", "3.0")  # called by what is called
    assert run(package)[0] == 9.0
    change(package, "numbers", "OFFSET = 0.0", "OFFSET = 100.0")
    assert run(package)[0] == 109.0
    change(package, "beside", "y - 1.0", "y + 1.0")  # behind a module
    assert run(package)[0] == 111.0
    change(package, "numbers", "STEP = 0.0", "STEP = 10.0")
    assert run(package)[0] == 121.0
    change(package, "numbers", "    x: float\n    y: float", "    y: float\n    x: float")
    assert run(package)[0] == 117.0


def test_a_folder_that_the_user_chose_is_used(package, tmp_path):
    chosen = tmp_path / "chosen"
    assert run(package, NUMBA_CACHE_DIR=str(chosen)) == (6.0, False)
    assert list(chosen.rglob("*.nbc"))
    assert not list(package.rglob("*.nbc"))
    change(package, "far", "2.0", "3.0")
    assert run(package, NUMBA_CACHE_DIR=str(chosen))[0] == 9.0


def test_an_installation_that_cannot_be_written_uses_the_users_cache(package, tmp_path):
    (package / "__pycache__").write_text("no folder can be made here")
    assert run(package, XDG_CACHE_HOME=str(tmp_path / "home")) == (6.0, False)
    assert run(package, XDG_CACHE_HOME=str(tmp_path / "home")) == (6.0, True)
    change(package, "far", "2.0", "3.0")
    assert run(package, XDG_CACHE_HOME=str(tmp_path / "home"))[0] == 9.0


def test_processes_at_once_read_no_half_of_a_kernel(package):
    path = os.pathsep.join([str(package.parent), *map(str, ROOMS)])
    started = [
        subprocess.Popen(
            [sys.executable, "-c", RUN],
            env={**os.environ, "PYTHONPATH": path},
            stdout=subprocess.PIPE,
            text=True,
        )
        for _ in range(4)
    ]
    assert [process.communicate()[0].split()[0] for process in started] == ["6.0"] * 4


def test_every_package_with_kernels_has_its_cache_watched():
    packages = [path for room in ROOMS for path in room.glob("rpod*") if path.is_dir()]
    with_kernels = [path for path in packages if any(_makes_kernels(file) for file in path.rglob("*.py"))]
    assert with_kernels
    for path in with_kernels:
        text = (path / "__init__.py").read_text("utf-8")
        assert "watch_callees()" in text, (
            f"{path.name}/__init__.py: call rpod_schemas.caches.kernels.watch_callees"
        )


def _makes_kernels(file):
    return any(
        isinstance(node, ast.ImportFrom) and node.module == "numba"
        for node in ast.walk(ast.parse(file.read_text("utf-8")))
    )
