"""Which software ran a trial: a digest of all the code that decides its outcome."""

import hashlib
from importlib.resources import files
from importlib.resources.abc import Traversable

_DECISIVE = (
    "rpod_schemas",
    "rpod_target",
    "rpod_sim_sensor",
    "rpod_motion",
    "rpod_estimator",
    "rpod_campaign",
)


def software_digest() -> str:
    """Return SHA-256 over the sources that a trial runs; tables and figures are not among them."""
    digest = hashlib.sha256()
    for package in _DECISIVE:
        for name, source in _sources(files(package), package):
            digest.update(f"{name}\0".encode())
            digest.update(source.read_bytes())
    return digest.hexdigest()


def _sources(folder: Traversable, name: str) -> list[tuple[str, Traversable]]:
    found = []
    for child in sorted(folder.iterdir(), key=lambda child: child.name):
        path = f"{name}/{child.name}"
        if child.is_dir():
            found += _sources(child, path)
        elif child.name.endswith(".py"):
            found.append((path, child))
    return found
