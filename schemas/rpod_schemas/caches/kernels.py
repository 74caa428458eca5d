"""Kernels are compiled again when anything changes that is compiled into them.

Numba caches a compiled kernel and compares its age with that of its source file alone. The names that the
kernel uses from other modules are compiled into it as well: called kernels, numbers, records. A change in one
of these would stay unnoticed. Here the stamp of a kernel's file also covers the names that the file imports
from other modules, and the names that these import. The locations of the cache are Numba's own
(``NUMBA_CACHE_DIR``, ``__pycache__``, the user's cache if an installation is read-only).

A cached kernel holds the machine code of all kernels that it calls, under names that end with a number.
Numba counts these numbers in each process from 1. So two kernels that different processes have compiled may
hold different code under one name, and a process that loads both uses one of them for both, which may end it
by SIGSEGV. Here each process counts from a random number.

A package with kernels calls ``watch_callees`` in its ``__init__``, before any kernel is defined.
Source: Numba, "Environment variables", NUMBA_CACHE_LOCATOR_CLASSES.
"""

import hashlib
import inspect
import secrets
from collections.abc import Mapping
from functools import cache
from itertools import count
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
from numba.core import caching, config
from numba.core.bytecode import FunctionIdentity
from numba.core.dispatcher import Dispatcher

_NUMBERS = (bool, int, float, complex, str, bytes)
_OWN = f"{__name__}."
_FORM = 2
"""Form of the cached code. That of form 1, with the same names in all processes, is not used any more."""
_NUMBER_BITS = 62
"""Bits of the number from which a process counts: two of thousands of processes never overlap."""

_writable: set[str] = set()
"""Folders in which this process has made a file."""


def watch_callees() -> None:
    """Let Numba's cache include other modules in a kernel's stamp, and name code as no other process does.

    A locator that the user chose stays.
    """
    if not getattr(config, "CACHE_LOCATOR_CLASSES"):  # noqa: B009 - its stub lacks the name
        own = ("UserProvided", "InTree", "UserWide")
        others = ("IPythonCacheLocator", "ZipCacheLocator")
        chosen = ",".join([*(_OWN + name for name in own), *others])
        setattr(config, "CACHE_LOCATOR_CLASSES", chosen)  # noqa: B010 - its stub lacks the name
    FunctionIdentity._unique_ids = count(secrets.randbits(_NUMBER_BITS))


class _Watching(caching._SourceFileBackedLocatorMixin):  # type: ignore[misc, unused-ignore]
    """Base of the locators whose stamp covers the names that a kernel's module uses from others."""

    def __init__(self, py_func: Any, py_file: str) -> None:
        super().__init__(py_func, py_file)  # type: ignore[call-arg]
        self._globals = py_func.__globals__

    def ensure_cache_path(self) -> None:
        """Make the folder of the cache, and try once whether it can be written, not for each kernel."""
        path = self.get_cache_path()  # type: ignore[attr-defined]
        if path not in _writable or not Path(path).is_dir():
            super().ensure_cache_path()  # type: ignore[misc]
            _writable.add(path)

    def get_source_stamp(self) -> bytes:
        """Return a digest of the kernel's file and of all that is compiled into the kernel from elsewhere."""
        own = super().get_source_stamp()  # type: ignore[no-untyped-call]
        return hashlib.sha256(repr((_FORM, own, sorted(_parts(self._globals)))).encode()).digest()


class UserProvided(_Watching, caching.UserProvidedCacheLocator):
    """Locator of the cache in ``NUMBA_CACHE_DIR``, if it is set."""


class InTree(_Watching, caching.InTreeCacheLocator):
    """Locator of the cache beside the source, if that folder is writable."""


class UserWide(_Watching, caching.UserWideCacheLocator):
    """Locator of the cache in the user's folder."""


class _Used(NamedTuple):
    """Content of a module that kernels can use."""

    names: Mapping[str, Any]
    """Names of the module, kept so that no other dictionary has their identity."""
    file: list[str]
    """Digest of the module's file, if there is one."""
    parts: list[str]
    """Values of the names."""
    modules: list[dict[str, Any]]
    """Names of the modules that some of them come from."""


_of_imported: dict[int, _Used] = {}
"""Contents of modules that are imported to their end, by the identity of their names."""


def _parts(names: Mapping[str, Any]) -> list[str]:
    """Return the values of a module's names that kernels can use; each further module is visited once."""
    first = _used(names)
    parts, seen, waiting = list(first.parts), {id(names)}, list(first.modules)
    while waiting:
        module = waiting.pop()
        if id(module) not in seen:
            seen.add(id(module))
            used = _used(module)
            parts += [*used.file, *used.parts]
            waiting += used.modules
    return parts


def _used(names: Mapping[str, Any]) -> _Used:
    """Return what a module uses; of a module that is imported to its end, as it was when first asked for."""
    if known := _of_imported.get(id(names)):
        return known
    used = _Used(names, _file(names), [], [])
    for name, value in list(names.items()):
        if not name.startswith("__"):
            _add(used, name, value)
    spec = names.get("__spec__")
    if spec is not None and not getattr(spec, "_initializing", True):
        _of_imported[id(names)] = used
    return used


def _add(used: _Used, name: str, value: Any) -> None:
    """Add a name and its value to what a module uses."""
    if isinstance(value, Dispatcher):
        used.modules.append(value.py_func.__globals__)
    elif isinstance(value, _NUMBERS):
        used.parts.append(f"{name}={value!r}")
    elif isinstance(value, tuple | list):
        for index, item in enumerate(value):
            _add(used, f"{name}[{index}]", item)
    elif inspect.isclass(value) and issubclass(value, tuple):  # a record
        annotations = inspect.get_annotations(value)
        used.parts.append(f"{name}={value.__module__}.{value.__qualname__}{annotations}")
        used.parts.append(f"{name}={getattr(value, '_fields', ())}")
    elif isinstance(value, np.ndarray | np.generic):
        used.parts.append(f"{name}={value.dtype}{np.shape(value)}{value.tobytes()!r}")
    elif isinstance(value, ModuleType) and value.__name__.startswith("rpod"):
        used.modules.append(vars(value))


def _file(names: Mapping[str, Any]) -> list[str]:
    """Return the digest of a module's file, if there is one."""
    file = names.get("__file__")
    if file is None or not Path(file).is_file():
        return []
    status = Path(file).stat()
    return [f"{names['__name__']}={_digest(file, status.st_mtime_ns, status.st_size)}"]


@cache
def _digest(file: str, modified_ns: int, size: int) -> str:
    del modified_ns, size  # they only distinguish one state of the file from another
    return hashlib.sha256(Path(file).read_bytes()).hexdigest()
