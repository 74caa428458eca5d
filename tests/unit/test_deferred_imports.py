"""What a process imports without use is not read, and is there for whoever uses it."""

import subprocess
import sys

import pytest

NAMES = "numpy.f2py.crackfortran", "numpy.testing._private.utils"
START = """
import sys
from rpod.deferred_imports import import_when_used
import_when_used("numpy.f2py", "numpy.testing")
import numpy, scipy.spatial.transform
"""


def loaded(code: str) -> set[str]:
    """Return which of the modules a new interpreter has read after some code."""
    code = f"{START}\n{code}\nprint(*({set(NAMES)} & sys.modules.keys()))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(done.stdout.split())


def test_rotations_of_scipy_read_neither_numpys_compiler_of_fortran_nor_its_tools_for_tests() -> None:
    assert loaded("") == set()


@pytest.mark.parametrize(
    ("use", "read"),
    [
        ("numpy.testing.assert_array_equal([1], [1])", NAMES[1]),
        ("from numpy.f2py import run_main", NAMES[0]),
    ],
)
def test_what_is_used_is_read(use: str, read: str) -> None:
    assert read in loaded(use)
