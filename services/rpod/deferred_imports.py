"""Modules that are imported at their first use, where a library asks for them and we never use them.

SciPy copies every name of NumPy when it is imported. That imports NumPy's compiler of Fortran and its tools
for tests: about 0.15 s of processor time at each start of a service.
"""

import sys
from collections.abc import Sequence
from importlib.machinery import ModuleSpec, PathFinder
from importlib.util import LazyLoader
from types import ModuleType


class _Later:
    """A finder whose modules are read when an attribute of them is asked for."""

    def __init__(self, names: Sequence[str]) -> None:
        self._names = frozenset(names)

    def find_spec(
        self, name: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return the specification of one of the modules, with a loader that waits."""
        spec = PathFinder.find_spec(name, path, target) if name in self._names else None
        if spec is not None and spec.loader is not None:
            spec.loader = LazyLoader(spec.loader)
        return spec


def import_when_used(*names: str) -> None:
    """Let this process import each of these modules when it is used first."""
    sys.meta_path.insert(0, _Later(names))
