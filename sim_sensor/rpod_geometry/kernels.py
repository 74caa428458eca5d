"""The one decorator that compiles the numerical kernels of the project.

A kernel is a function that numba compiles at its first call. It takes arrays, numbers and records of these
(``typing.NamedTuple``), at most seven arguments, and returns a number, an array, a record or at most three of
them. Its docstring gives shapes and units. A test checks these rules (``tests/unit/test_kernels.py``).
"""

from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

from numba import njit

P = ParamSpec("P")
R = TypeVar("R")


def kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Return a compiled function: cached on disk, without the interpreter's lock, on one thread.

    Divisions by zero give inf or NaN as in NumPy, so that no kernel raises for them. For type checkers the
    function keeps its signature, since numba has no stubs.
    """
    compiled: Callable[P, R] = _kept(njit(cache=True, nogil=True, error_model="numpy")(function))
    return compiled


def reassociated_kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Return a kernel that may assume that no number is NaN and ignore signs of zeros, for fast minima.

    It is for inner loops whose callers guarantee that no argument is NaN.
    """
    flags = {"nnan", "nsz"}
    compiled: Callable[P, R] = _kept(
        njit(cache=True, nogil=True, error_model="numpy", fastmath=flags)(function)
    )
    return compiled


def inlined_kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Return a kernel whose statements are put into each kernel that calls it.

    It is for what an inner loop calls with records of many arrays: a call counts a reference to each of them,
    which takes longer than a few hundred additions.
    """
    compiled: Callable[P, R] = _kept(
        njit(cache=True, nogil=True, error_model="numpy", inline="always")(function)
    )
    return compiled


def generic_kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Return a kernel that is compiled into each kernel that calls it, and has no cache file of its own.

    It is for kernels whose arguments are records of other modules: a cache file would not show that it is
    old.
    """
    compiled: Callable[P, R] = njit(nogil=True, error_model="numpy")(function)
    return compiled


def _kept(compiled: Any) -> Any:
    """Return a kernel that ignores its cache file if the file names a record that no longer exists.

    This is necessary because numba reads the types in a cache file before it checks whether the file is old.
    """
    file = compiled._cache._cache_file
    load = file._load_index

    def load_index() -> Any:
        try:
            return load()
        except (AttributeError, ImportError):
            return {}

    file._load_index = load_index
    return compiled
