"""Software of a trial: a digest of the code that determines its outcome, and versions of libraries."""

import hashlib
import platform
from functools import lru_cache
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from importlib.resources import files
from importlib.resources.abc import Traversable
from importlib.util import find_spec
from pathlib import Path

from rpod_campaign.engine.campaign import AnyCampaign
from rpod_schemas.registry import providers

_DECISIVE = (
    "rpod_schemas",
    "rpod_target",
    "rpod_sim_sensor",
    "rpod_motion",
    "rpod_geometry",
    "rpod_pose",
    "rpod_analysis.scoring",
    "rpod_campaign.engine.trial",
    "rpod_campaign.lidar",
    "rpod_campaign.pmd",
)
_OURS = "rpod_campaign"
_REPORTS = ("report", "options.py")
"""Folders and files of this package that do not affect a row."""
_LIBRARIES = ("numpy", "scipy", "numba", "opencv-python-headless")
"""Packages whose version may change the last bit of a row."""


def software_digest(campaign: AnyCampaign) -> str:
    """Return SHA-256 of the sources that a campaign's trial runs, without those of tables and figures.

    Of another package that provides the campaign, a sensor kind or a method, all sources count.
    """
    return _digest(campaign.trial.__module__)


def identity(campaign: AnyCampaign) -> dict[str, str]:
    """Return the versions and digests that must be equal in all processes that run a campaign's trials."""
    return {
        "rpod": _version("rpod"),
        "code": software_digest(campaign)[:12],
        "python": ".".join(platform.python_version_tuple()[:2]),
        "machine": platform.machine(),
        **{library: _version(library) for library in _LIBRARIES},
    }


def differences(mine: dict[str, str], theirs: dict[str, str]) -> list[str]:
    """Return the differences between two identities, as texts."""
    return [
        f"{name} is {theirs.get(name, 'unknown')}, not {value}"
        for name, value in mine.items()
        if theirs.get(name) != value
    ]


@lru_cache(maxsize=32)
def _digest(trial_module: str) -> str:
    digest = hashlib.sha256()
    for name, source in _all_sources(trial_module):
        digest.update(f"{name}\0".encode())
        digest.update(source.read_bytes())
    return digest.hexdigest()


def _all_sources(trial_module: str) -> list[tuple[str, Traversable]]:
    found = [source for package in _DECISIVE for source in _sources(files(package), package)]
    others = {top for top in providers() if top not in _DECISIVE}
    if trial_module.startswith(f"{_OURS}."):
        modules, services = _trials(trial_module)
        others |= services
        for module in modules:
            package, _, name = module.rpartition(".")
            found.append((module, files(package) / f"{name}.py"))
    else:
        others.add(trial_module.partition(".")[0])
    return found + [source for top in sorted(others) for source in _sources_of(top)]


def _trials(trial_module: str) -> tuple[list[str], set[str]]:
    """Return the modules of a trial and of campaigns that it uses, without reports and options.

    Also returns the other packages of this project that these modules use, as services that a trial runs.
    """
    found, left, services = set(), {trial_module}, set()
    while left:
        module = left.pop()
        found.add(module)
        made_in = {str(getattr(value, "__module__", "")) for value in vars(import_module(module)).values()}
        others = {name for name in made_in if name.startswith("rpod_") and not _is_decisive(name)}
        mine = {name for name in others if name.startswith(f"{_OURS}.")}
        services |= {name.partition(".")[0] for name in others - mine} - {_OURS}
        left |= {name for name in mine if name.rpartition(".")[2] not in ("report", "options")} - found
    return sorted(found), services


def _is_decisive(module: str) -> bool:
    return any(module == package or module.startswith(f"{package}.") for package in _DECISIVE)


def _sources_of(top: str) -> list[tuple[str, Traversable]]:
    """Return the sources of another package, or of one that is a single module."""
    spec = find_spec(top)
    if spec is not None and spec.origin and not spec.submodule_search_locations:
        return [(top, Path(spec.origin))]
    return _sources(files(top), top)


def _sources(folder: Traversable, name: str) -> list[tuple[str, Traversable]]:
    left_out, found = _REPORTS if name.startswith(f"{_OURS}.") else (), []
    for child in sorted(folder.iterdir(), key=lambda child: child.name):
        path = f"{name}/{child.name}"
        if child.name in left_out:
            continue
        if child.is_dir():
            found += _sources(child, path)
        elif child.name.endswith(".py"):
            found.append((path, child))
    return found


def _version(distribution: str) -> str:
    try:
        return version(distribution)
    except PackageNotFoundError:
        return "not installed"
