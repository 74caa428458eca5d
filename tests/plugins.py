"""Packages of the examples, installed for one test: into a folder of its own, without a network."""

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / "docs" / "examples"


def installed(name: str, folder: Path) -> Path:
    """Install an example into a folder, and return the folder."""
    source = folder / "source" / name
    _copy(EXAMPLES / name, source)
    command = (sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation")
    where = folder / "site"
    subprocess.run((*command, "--no-index", "--target", str(where), str(source)), check=True, timeout=600)
    return where


def _copy(source: Path, target: Path) -> None:
    """Copy an example, so that a build leaves nothing behind in the project."""
    for file in source.rglob("*"):
        if file.is_file() and "__pycache__" not in file.parts:
            to = target / file.relative_to(source)
            to.parent.mkdir(parents=True, exist_ok=True)
            to.write_bytes(file.read_bytes())


def with_packages(where: Path, *arguments: str, modules: Sequence[str] = ("rpod",)) -> str:
    """Run ``python -m rpod`` with the packages of a folder; return its output. Fails with it."""
    environment = os.environ | {"PYTHONPATH": str(where)}
    done = subprocess.run(
        (sys.executable, "-m", *modules, *arguments),
        env=environment,
        capture_output=True,
        text=True,
        timeout=170,
        check=False,
        cwd=where,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout
