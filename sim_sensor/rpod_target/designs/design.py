"""A shipped design: its components, and its parameter file and mesh file."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
import yaml

from rpod_schemas.arrays import FloatArray
from rpod_target.modelling.component import Component, joined
from rpod_target.modelling.files import parts, to_glb
from rpod_target.modelling.materials import MATERIALS
from rpod_target.parameters import MaterialParameters

Coordinates = Sequence[float] | FloatArray
"""Three coordinates."""


@dataclass(frozen=True, eq=False)
class Design:
    """A target that a program builds from its dimensions, all in metres and target axes."""

    name: str
    about: str
    """Description of the target, which becomes the comment at the head of its parameter file."""
    components: tuple[Component, ...]
    mass: dict[str, Any]
    """Mass properties as fields of the parameter file."""
    spacing_m: float
    """Spacing of the distance field."""
    margin_m: float
    """Extent of the distance field beyond the target."""
    symmetries: tuple[dict[str, Any], ...] = ()
    """Symmetries as in the parameter file."""
    own_materials: dict[str, MaterialParameters] = field(default_factory=dict)
    """Materials beside the common ones."""

    @property
    def mesh_file(self) -> str:
        """Path of the mesh file, relative to the parameter file."""
        return f"meshes/{self.name}.glb"

    def parameters(self) -> str:
        """Return the text of the parameter file (YAML)."""
        used = {each.material for each in self.components}
        document: dict[str, Any] = {
            "name": self.name,
            **self.mass,
            "materials": {
                name: material.model_dump(exclude_defaults=True)
                for name, material in {**MATERIALS, **self.own_materials}.items()
                if name in used
            },
            "parts": parts(self.components, self.mesh_file),
            "distance_field": {"spacing_m": self.spacing_m, "margin_m": self.margin_m},
            "symmetries": list(self.symmetries),
        }
        head = "".join(f"# {line}".rstrip() + "\n" for line in self.about.strip().splitlines())
        return head + yaml.safe_dump(document, sort_keys=False, width=110, default_flow_style=None)

    def write(self, folder: Path) -> Path:
        """Write both files into a folder and return the path of the parameter file. Raises OSError."""
        mesh = folder / self.mesh_file
        mesh.parent.mkdir(parents=True, exist_ok=True)
        mesh.write_bytes(to_glb(self.components))
        file = folder / f"{self.name}.yaml"
        file.write_text(self.parameters(), encoding="utf-8")
        return file


def part(name: str, material: str, *meshes: trimesh.Trimesh) -> Component:
    """Return meshes of one material as a component."""
    return Component(name, joined(*meshes), material)


def pose_on(point: Coordinates, normal: Coordinates, along: Coordinates) -> FloatArray:
    """Return the pose, shape (4, 4), of something at a point with its z axis along a normal.

    Args:
        point: position, shape (3,).
        normal: direction of the z axis, of any length.
        along: direction near the x axis; its share along the normal does not count.
    """
    z = np.asarray(normal, float) / np.linalg.norm(normal)
    y = np.cross(z, along)
    y /= np.linalg.norm(y)
    matrix = np.eye(4)
    matrix[:3] = np.column_stack((np.cross(y, z), y, z, point))
    return matrix


def around(angle_deg: float, radius: float, x: float) -> FloatArray:
    """Return the point at an angle about the x axis, from y towards z, shape (3,)."""
    angle = np.deg2rad(angle_deg)
    return np.array((x, radius * np.cos(angle), radius * np.sin(angle)))
