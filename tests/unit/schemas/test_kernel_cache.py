"""A kernel is compiled anew when what it takes from other modules has changed, and only then."""

import ast
import os
import subprocess
import sys
from contextlib import contextmanager
from importlib.machinery import ModuleSpec
from pathlib import Path

import pytest

from rpod_schemas.caches import kernels

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
RUN = """
from rpod_tiny import kernel; import os
said = kernel.result(3.0), *kernel.result.stats.cache_hits.values()
os.write(1, (" ".join(map(str, said)) + "\\n").encode())
"""
FORKS = f"""
import os, sys
import rpod_schemas.caches.kernels  # and Numba, which takes longer than a run
for line in sys.stdin:
    children = []
    for _ in range(int(line)):
        if not (child := os.fork()):
            exec({RUN!r})
            os._exit(0)
        children.append(child)
    assert not any(os.waitpid(child, 0)[1] for child in children)
"""


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


@pytest.fixture
def at_once(package):
    """Run the package in some new processes at the same time; return value and use of the cache of each."""
    with new_processes(package) as run:
        yield run


@contextmanager
def new_processes(package, **environment):
    """Give a function that runs the package in some new processes at the same time."""
    with subprocess.Popen(
        [sys.executable, "-c", FORKS],
        env=environment_of(package) | environment,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as forking:

        def run(count):
            forking.stdin.write(f"{count}\n")
            forking.stdin.flush()
            return [outcome(forking.stdout.readline()) for _ in range(count)]

        yield run
        forking.stdin.close()
    assert forking.returncode == 0


def environment_of(package):
    path = os.pathsep.join([str(package.parent), *map(str, ROOMS)])
    return {**os.environ, "PYTHONPATH": path, "NUMBA_OPT": "1"}  # which compiles faster


def outcome(line):
    value, *hits = line.split()
    return float(value), bool(hits)


def change(package, module, old, new):
    """Change a module at another second: bytecode of the same second and size would be taken for it."""
    file = package / f"{module}.py"
    text, later_s = file.read_text(), file.stat().st_mtime + 2.0
    assert old in text
    file.write_text(text.replace(old, new))
    os.utime(file, (later_s, later_s))


def test_a_change_is_seen_wherever_it_is_and_what_has_not_changed_is_not_compiled_again(package, at_once):
    assert at_once(1) == [(6.0, False)]
    change(package, "shell", "not", "never")
    assert at_once(1) == [(6.0, True)]
    for module, old, new, value in (
        ("far", "2.0", "3.0", 9.0),  # called by what is called
        ("numbers", "OFFSET = 0.0", "OFFSET = 100.0", 109.0),
        ("beside", "y - 1.0", "y + 1.0", 111.0),  # behind a module
        ("numbers", "STEP = 0.0", "STEP = 10.0", 121.0),
        ("numbers", "    x: float\n    y: float", "    y: float\n    x: float", 117.0),
    ):
        change(package, module, old, new)
        assert at_once(1)[0][0] == value


def test_a_folder_that_the_user_chose_is_used(package, tmp_path):
    chosen = tmp_path / "chosen"
    with new_processes(package, NUMBA_CACHE_DIR=str(chosen)) as run:
        assert run(1) == [(6.0, False)]
        assert list(chosen.rglob("*.nbc"))
        assert not list(package.rglob("*.nbc"))
        change(package, "far", "2.0", "3.0")
        assert run(1)[0][0] == 9.0


def test_an_installation_that_cannot_be_written_uses_the_users_cache(package, tmp_path):
    (package / "__pycache__").write_text("no folder can be made here")
    with new_processes(package, XDG_CACHE_HOME=str(tmp_path / "home")) as run:
        assert run(1) == [(6.0, False)]
        assert run(1) == [(6.0, True)]
        change(package, "far", "2.0", "3.0")
        assert run(1)[0][0] == 9.0


def test_processes_at_once_read_no_half_of_a_kernel(at_once):
    assert [value for value, _ in at_once(4)] == [6.0] * 4


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


def test_two_processes_name_the_code_of_a_kernel_differently():
    script = (
        INIT
        + """
from numba import njit
shifted = njit(lambda x: x + 1.0)
shifted(1.0)
print(shifted.overloads[shifted.signatures[0]].fndesc.mangled_name)
"""
    )
    one, other = (
        subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=True)
        for _ in range(2)
    )
    assert one.stdout.strip()
    assert one.stdout != other.stdout, "of two kernels in one process, one would run the code of the other"


def test_a_module_is_examined_once_when_it_is_imported_to_its_end(monkeypatch):
    whole, begun = {"STEP": 2.0, "__spec__": ModuleSpec("whole", None)}, {"STEP": 2.0}
    whole["__spec__"]._initializing = False
    monkeypatch.setattr(kernels, "_of_imported", {})
    assert kernels._parts(whole) == kernels._parts(begun) == ["STEP=2.0"]
    whole["MORE"] = begun["MORE"] = 1
    assert kernels._parts(whole) == ["STEP=2.0"]
    assert kernels._parts(begun) == ["STEP=2.0", "MORE=1"]
