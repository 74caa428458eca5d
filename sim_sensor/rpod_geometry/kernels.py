"""The one decorator that compiles the numerical kernels of the project.

A kernel is a function that numba compiles at its first call. It takes arrays, numbers and records of these
(``typing.NamedTuple``), at most seven arguments, and returns a number, an array, a record or at most three of
them. Its docstring gives shapes and units. A test checks these rules (``tests/unit/test_kernels.py``).
"""

from collections.abc import Callable, Iterable
from contextlib import ExitStack, suppress
from fcntl import LOCK_EX, LOCK_SH, flock
from functools import partial
from pathlib import Path
from typing import Any, NoReturn, ParamSpec, TypeVar

from numba import njit
from numba.core.types import unliteral

P = ParamSpec("P")
R = TypeVar("R")
_njit: Any = njit  # its stub lacks the options of wrappers
_compiled: Any = partial(_njit, nogil=True, error_model="numpy", no_cfunc_wrapper=True)
"""Numba's decorator with the options of all kernels. No kernel is given to another one as a value, which
would need a wrapper for C."""


def kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Return a compiled function: cached on disk, without the interpreter's lock, on one thread.

    Divisions by zero give inf or NaN as in NumPy, so that no kernel raises for them. For type checkers the
    function keeps its signature, since numba has no stubs.
    """
    compiled: Callable[P, R] = _kept(_compiled(cache=True)(function))
    return compiled


def inner_kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Return a kernel that only other kernels call; Python receives a ``TypeError``.

    It takes less time to compile: the code that reads a record of forty arrays from Python takes longer to
    compile than a short kernel.
    """
    compiled: Any = _kept(_compiled(cache=True, no_cpython_wrapper=True)(function))

    def refused(*args: Any, **kwargs: Any) -> NoReturn:
        del args, kwargs
        raise TypeError(f"{function.__qualname__} is an inner kernel: only kernels can call it")

    # The code has no address that Python could call: Numba's dispatcher never learns that it is compiled.
    compiled._insert, compiled._compile_for_args = (lambda *_: None), refused
    called: Callable[P, R] = compiled
    return called


def reassociated_kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Return a kernel that may assume that no number is NaN and ignore signs of zeros, for fast minima.

    It is for inner loops whose callers guarantee that no argument is NaN.
    """
    flags = {"nnan", "nsz"}
    compiled: Callable[P, R] = _kept(_compiled(cache=True, fastmath=flags)(function))
    return compiled


def inlined_kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Return a kernel whose statements are inserted into each kernel that calls it.

    It is for functions that an inner loop calls with records of many arrays: a call counts a reference to
    each array, which takes longer than a few hundred additions.
    """
    compiled: Callable[P, R] = _kept(_compiled(cache=True, inline="always")(function))
    return compiled


def generic_kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Return a kernel that is compiled into each kernel that calls it, and has no cache file of its own.

    It is for kernels whose arguments are records of other modules: a cache file would not show that it is out
    of date.
    """
    compiled: Callable[P, R] = _compiled()(function)
    return compiled


def _kept(compiled: Any) -> Any:
    """Return a kernel whose cache file is safe to read.

    It ignores a file that names a record that no longer exists: numba reads the types in a file before it
    checks whether the file is out of date. Only one process writes at a time, and none reads meanwhile
    (``one_at_a_time``). The kernel is compiled once for a type, and not again for each literal number.
    """
    template = compiled.get_call_template

    def get_call_template(args: Iterable[Any], kws: dict[str, Any]) -> Any:
        return template([_plain(each) for each in args], {name: _plain(each) for name, each in kws.items()})

    compiled.get_call_template = get_call_template
    file = compiled._cache._cache_file
    load = file._load_index

    def load_index() -> Any:
        try:
            return load()
        except (AttributeError, ImportError):
            return {}

    file._load_index = load_index
    one_at_a_time(file)
    return compiled


def _plain(kind: Any) -> Any:
    """Return a type without the value that Numba may know."""
    return unliteral(kind)  # type: ignore[no-untyped-call]


def one_at_a_time(file: Any) -> None:
    """Make numba's cache file of a kernel wait while another process writes it.

    Numba chooses the number of a file from an index that it reads before. Of two processes that compile a
    kernel for different types at once, both may choose the same number. The index then gives one type the
    code of the other, which ends a process by SIGSEGV.
    """

    def locked(call: Callable[P, R], lock: int) -> Callable[P, R]:
        def waits(*args: P.args, **kwargs: P.kwargs) -> R:
            with ExitStack() as held:
                # There is no folder yet, or it is read-only: no process of this project writes there.
                with suppress(OSError):
                    opened = held.enter_context(Path(file._cache_path, "kernels.lock").open("a"))
                    flock(opened, lock)
                return call(*args, **kwargs)

        return waits

    file.save, file.load = locked(file.save, LOCK_EX), locked(file.load, LOCK_SH)
