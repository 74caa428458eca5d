"""Targets for tests: written as parameter files, built into one cache."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from rpod_target import Target, load_target


@pytest.fixture(scope="session")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


@pytest.fixture
def document() -> dict[str, Any]:
    """A box of 2 x 1 x 0.5 m, as a parameter file's content."""
    return {
        "name": "brick",
        "centre_of_mass_m": [0.0, 0.0, 0.0],
        "inertia_kg_m2": [[2.0, 0.0, 0.0], [0.0, 3.0, 0.0], [0.0, 0.0, 4.0]],
        "materials": {
            "paint": {"reflectivity": 0.5, "diffuse": 0.4, "f0": 0.02, "roughness": 0.3},
            "foil": {"reflectivity": 0.7, "diffuse": 0.1, "f0": 0.8, "roughness": 0.05},
        },
        "parts": [{"name": "block", "shape": "box", "size_m": [2.0, 1.0, 0.5], "material": "paint"}],
        "distance_field": {"spacing_m": 0.1, "margin_m": 0.3},
        "model_points": 200,
    }


@pytest.fixture
def write(tmp_path: Path) -> Callable[[dict[str, Any]], Path]:
    def write(document: dict[str, Any]) -> Path:
        file = tmp_path / "target.yaml"
        file.write_text(yaml.safe_dump(document, sort_keys=False), encoding="utf-8")
        return file

    return write


@pytest.fixture
def build(
    document: dict[str, Any], write: Callable[[dict[str, Any]], Path], cache: Path
) -> Callable[..., Target]:
    """Build the brick with other parts or other fields."""

    def build(*parts: dict[str, Any], **fields: Any) -> Target:
        named = [{"name": f"part-{number}", "material": "paint", **part} for number, part in enumerate(parts)]
        return load_target(write(document | {"parts": named or document["parts"]} | fields), cache=cache)

    return build


@pytest.fixture
def write_stl(tmp_path: Path) -> Callable[[str, Any], Path]:
    """Write triangles, shape (T, 3, 3), as a binary STL file."""

    def write_stl(name: str, triangles: Any) -> Path:
        records = np.zeros(
            len(triangles), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")]
        )
        records["corners"] = triangles
        file = tmp_path / name
        file.write_bytes(
            b"solid, but binary".ljust(80) + len(records).to_bytes(4, "little") + records.tobytes()
        )
        return file

    return write_stl
