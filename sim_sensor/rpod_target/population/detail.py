"""Detail of the random satellites: the crinkles of foil, screws, and as many triangles as CAD files have."""

from dataclasses import replace

import numpy as np
import trimesh
from numpy.random import Generator

from rpod_target.modelling.component import Component, facing, joined, placed, places
from rpod_target.population.bodies import MainBody
from rpod_target.population.materials import FOILS

_CRINKLE = 0.12
"""Standard deviation of the height of a crinkle, as a share of the length of its facets' edges."""
_SCREW_TRIANGLES = 24
_MOST_SCREWS = 400


def screws(body: MainBody, generator: Generator, *, triangles: int) -> list[Component]:
    """Return hexagonal screws on the body, of at most so many triangles together."""
    count = min(_MOST_SCREWS, triangles // _SCREW_TRIANGLES)
    if count < 1:
        return []
    radius = 0.02 * body.radius
    one = trimesh.creation.cylinder(radius=radius, height=2.0 * radius, sections=6)
    points, normals = places(body.core, count, generator)
    heads = [placed(one, facing(point, normal)) for point, normal in zip(points, normals, strict=True)]
    return [Component("screws", joined(*heads), "steel")]


def refined(components: list[Component], *, triangles: int) -> list[Component]:
    """Return components with more triangles on the same surfaces, at most ``triangles`` together.

    The component with the largest triangles is divided first; each division makes four of one.
    """
    found = list(components)
    while True:
        count = sum(len(component.mesh.faces) for component in found)
        coarse = [k for k, each in enumerate(found) if count + 3 * len(each.mesh.faces) <= triangles]
        if not coarse:
            return found
        largest = max(coarse, key=lambda k: found[k].area / len(found[k].mesh.faces))
        found[largest] = replace(found[largest], mesh=found[largest].mesh.subdivide())


def crinkled(component: Component, generator: Generator) -> Component:
    """Return a component whose corners are moved along their normals, if its material is a foil."""
    if component.material not in FOILS:
        return component
    mesh = component.mesh.copy()
    edge = np.sqrt(component.area / len(mesh.faces))
    height = _CRINKLE * edge * generator.standard_normal(len(mesh.vertices)).clip(-2.0, 2.0)
    height = np.minimum(np.abs(height), 0.004) * np.sign(height)
    mesh.vertices = mesh.vertices + height[:, None] * mesh.vertex_normals
    return replace(component, mesh=mesh)
