"""Files of a target that is made of components: one mesh file, and its parts in the parameter file."""

from collections.abc import Sequence
from typing import Any

import trimesh
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

from rpod_target.modelling.component import Component


def parts(components: Sequence[Component], file: str) -> list[dict[str, Any]]:
    """Return the parts of the parameter file, one for each component, which is an object of a mesh file."""
    return [
        {
            "name": each.name,
            "shape": "mesh",
            "file": file,
            "object": each.name,
            "metres_per_unit": 1.0,
            "material": each.material,
        }
        for each in components
    ]


def to_glb(components: Sequence[Component]) -> bytes:
    """Return the components as one mesh file in metres (GLB), each an object with its material."""
    scene = trimesh.Scene()
    for each in components:
        mesh = trimesh.Trimesh(each.mesh.vertices, each.mesh.faces, process=False)
        material = PBRMaterial(name=each.material)  # type: ignore[no-untyped-call]
        mesh.visual = TextureVisuals(material=material)  # type: ignore[no-untyped-call]
        scene.add_geometry(mesh, node_name=each.name, geom_name=each.name)
    exported = scene.export(file_type="glb")  # type: ignore[no-untyped-call]
    if not isinstance(exported, bytes):
        raise TypeError(f"the GLB export gave {type(exported).__name__}, not bytes")
    return exported
