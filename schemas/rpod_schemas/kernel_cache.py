"""Compiled kernels are compiled anew when anything changes that is compiled into them.

Numba keeps a compiled kernel beside its source, and knows it to be old by that one file. Whatever the kernel
takes from other modules is compiled into it as well: the kernels that it calls, numbers, records. So a change
in one of these went unnoticed. Here the stamp of a kernel's file also covers what the file has from others,
and what these have from others in their turn; the places of the cache stay Numba's own (``NUMBA_CACHE_DIR``,
``__pycache__``, the user's cache where an installation is read-only).

A package that has kernels calls ``watch_callees`` in its ``__init__``, before any of them is made.
Source: Numba, "Environment variables", NUMBA_CACHE_LOCATOR_CLASSES.
"""

import hashlib
import inspect
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numba.core import caching, config
from numba.core.dispatcher import Dispatcher

_NUMBERS = (bool, int, float, complex, str, bytes)
_OWN = f"{__name__}."


def watch_callees() -> None:
    """Let Numba's cache know what kernels have from other modules; a choice of the user's own stays."""
    if not getattr(config, "CACHE_LOCATOR_CLASSES"):  # noqa: B009 - its stub lacks the name
        own = ("UserProvided", "InTree", "UserWide")
        others = ("IPythonCacheLocator", "ZipCacheLocator")
        chosen = ",".join([*(_OWN + name for name in own), *others])
        setattr(config, "CACHE_LOCATOR_CLASSES", chosen)  # noqa: B010 - its stub lacks the name


class _Watching(caching._SourceFileBackedLocatorMixin):  # type: ignore[misc, unused-ignore]
    """A locator whose stamp covers what the kernel's module has from others."""

    def __init__(self, py_func: Any, py_file: str) -> None:
        super().__init__(py_func, py_file)  # type: ignore[call-arg]
        self._globals = py_func.__globals__

    def get_source_stamp(self) -> bytes:
        """Return a digest of the kernel's file and of what is compiled in from elsewhere."""
        own = super().get_source_stamp()  # type: ignore[no-untyped-call]
        return hashlib.sha256(repr((own, sorted(_parts(self._globals, set())))).encode()).digest()


class UserProvided(_Watching, caching.UserProvidedCacheLocator):
    """In ``NUMBA_CACHE_DIR``, where it is set."""


class InTree(_Watching, caching.InTreeCacheLocator):
    """Beside the source, where that can be written."""


class UserWide(_Watching, caching.UserWideCacheLocator):
    """In the user's cache."""


def _parts(names: Mapping[str, Any], seen: set[int]) -> Iterator[str]:
    """Yield the values of a module's names that kernels can use; each module is visited once."""
    seen.add(id(names))
    for name, value in list(names.items()):
        if not name.startswith("__"):
            yield from _part(name, value, seen)


def _part(name: str, value: Any, seen: set[int]) -> Iterator[str]:
    if isinstance(value, Dispatcher):
        yield from _module(value.py_func.__globals__, seen)
    elif isinstance(value, _NUMBERS):
        yield f"{name}={value!r}"
    elif isinstance(value, tuple | list):
        for index, item in enumerate(value):
            yield from _part(f"{name}[{index}]", item, seen)
    elif inspect.isclass(value) and issubclass(value, tuple):  # a record
        yield f"{name}={value.__module__}.{value.__qualname__}{inspect.get_annotations(value)}"
        yield f"{name}={getattr(value, '_fields', ())}"
    elif isinstance(value, np.ndarray | np.generic):
        yield f"{name}={value.dtype}{np.shape(value)}{value.tobytes()!r}"
    elif isinstance(value, ModuleType) and value.__name__.startswith("rpod"):
        yield from _module(vars(value), seen)


def _module(names: dict[str, Any], seen: set[int]) -> Iterator[str]:
    if id(names) in seen:
        return
    file = names.get("__file__")
    if file is not None and Path(file).is_file():
        status = Path(file).stat()
        yield f"{names['__name__']}={_digest(file, status.st_mtime_ns, status.st_size)}"
    yield from _parts(names, seen)


@cache
def _digest(file: str, modified_ns: int, size: int) -> str:
    del modified_ns, size  # they only tell one state of the file from another
    return hashlib.sha256(Path(file).read_bytes()).hexdigest()
