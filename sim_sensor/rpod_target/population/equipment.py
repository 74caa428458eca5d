"""Equipment of the random satellites: solar arrays, dishes, booms, nozzles, adapter rings, instruments."""

from typing import Literal

import numpy as np
import trimesh
from numpy.random import Generator
from scipy.spatial.transform import Rotation

from rpod_schemas.arrays import FloatArray
from rpod_target.modelling.component import Component, along_x, bar, facing, joined, placed, places, pose
from rpod_target.modelling.shapes import bell, feed_struts, panel_row, reflector
from rpod_target.population.bodies import MainBody
from rpod_target.population.materials import BARE, FOILS

Arrays = Literal["none", "one", "two", "asymmetrical"]
_Y = np.array([0.0, 1.0, 0.0])


def solar_arrays(
    kind: Arrays, body: MainBody, generator: Generator, *, plain: bool, along: float, sections: int
) -> list[Component]:
    """Return wings of panels along +y and -y: two are alike; asymmetrical ones differ in size and angle.

    Args:
        kind: number and kind of the wings.
        body: body that carries them.
        generator: random numbers of the satellite.
        plain: whether both sides of a panel have the same material, and the wings a half turn about x.
        along: place of the wings along x.
        sections: number of facets of round parts.
    """
    if kind == "none":
        return []
    span, chord = float(generator.uniform(0.4, 2.2)), float(generator.uniform(0.25, 0.7))
    tilt, panels = float(generator.uniform(-1.2, 1.2)), int(generator.integers(1, 5))
    wings = [(span, chord, tilt, panels)]
    if kind == "two":
        wings.append((span, chord, tilt if plain else -tilt, panels))
    elif kind == "asymmetrical":
        share, narrower, turned = generator.uniform((0.3, 0.6, 0.3), (0.75, 1.0, 1.2)).tolist()
        wings.append((share * span, narrower * chord, turned - tilt, max(1, panels - 1)))
    # A half turn about x repeats the wing; one about z, with the opposite tilt, lets all cells face one way.
    other = Rotation.from_euler("x" if plain else "z", np.pi)
    back = "solar-cells" if plain else str(generator.choice(("white-paint", "grey-panel", "black-paint")))
    return [
        Component(f"{name}-{number}", placed(mesh, pose((along, 0.0, 0.0), turn)), material)
        for number, (wing, turn) in enumerate(zip(wings, (Rotation.identity(), other), strict=False), 1)
        for name, mesh, material in _wing(*wing, radius=body.radius, back=back, sections=sections)
    ]


def _wing(
    span: float, chord: float, tilt: float, panels: int, *, radius: float, back: str, sections: int
) -> list[tuple[str, trimesh.Trimesh, str]]:
    """Return name, mesh and material of a wing along y whose panels are turned about y."""
    thick, gap, yoke = 0.012 * chord + 0.004, 0.03 * span, 0.15 * span
    each = (span - yoke - gap * (panels - 1)) / panels
    cells, backs = panel_row(panels, (chord, each), gap, thick, begin=radius + yoke)
    end = radius + yoke + (panels - 1) * (each + gap) + 0.2 * each
    mast = bar(0.8 * radius * _Y, end * _Y, 0.35 * thick + 0.01 * chord, max(6, sections // 2))
    turned = pose((0.0, 0.0, 0.0), Rotation.from_euler("y", tilt))
    return [
        ("array-cells", placed(joined(*cells), turned), "solar-cells"),
        ("array-back", placed(joined(*backs), turned), back),
        ("array-mast", mast, "aluminium"),
    ]


def dish(number: int, body: MainBody, generator: Generator, *, sections: int) -> list[Component]:
    """Return a parabolic antenna on a mast, with its feed on three struts."""
    point, normal = mount(body, generator)
    radius = float(generator.uniform(0.15, 0.6)) * 0.5
    depth, thick = 0.35 * radius, 0.03 * radius
    shell = reflector(radius, depth, thick, sections)
    focus = np.array((0.0, 0.0, 0.9 * radius))
    struts = feed_struts(radius, depth, focus, 0.02 * radius)
    feed = placed(
        trimesh.creation.cylinder(radius=0.1 * radius, height=0.25 * radius, sections=max(8, sections // 2)),
        pose(focus),
    )
    height = float(generator.uniform(0.3, 1.2)) * radius
    aim = Rotation.from_euler("xz", generator.uniform((-0.9, -np.pi), (0.9, np.pi)))
    stand = facing(point, normal)
    top = stand @ pose((0.0, 0.0, height), aim)
    mast = bar(
        np.array((0.0, 0.0, -0.1 * radius)), np.array((0.0, 0.0, height + 0.3 * thick)), 0.06 * radius, 8
    )
    return [
        Component(f"dish-{number}", placed(shell, top), str(generator.choice(("white-paint", "grey-panel")))),
        Component(
            f"dish-feed-{number}",
            joined(placed(joined(feed, *struts), top), placed(mast, stand)),
            "aluminium",
        ),
    ]


def boom(number: int, body: MainBody, generator: Generator, *, sections: int) -> list[Component]:
    """Return a boom with a box at its tip, such as a magnetometer's."""
    point, normal = mount(body, generator)
    length, radius = float(generator.uniform(0.4, 1.6)), float(generator.uniform(0.006, 0.018))
    stand = facing(point, normal) @ pose(
        (0, 0, 0), Rotation.from_euler("x", float(generator.uniform(-0.6, 0.6)))
    )
    rod = bar(np.array((0.0, 0.0, -0.05)), np.array((0.0, 0.0, length)), radius, max(6, sections // 3))
    tip = placed(
        trimesh.creation.box(extents=radius * generator.uniform(3.0, 7.0, 3)), pose((0.0, 0.0, length))
    )
    return [Component(f"boom-{number}", placed(joined(rod, tip), stand), str(generator.choice(BARE)))]


def nozzle(body: MainBody, generator: Generator, *, sections: int) -> Component:
    """Return a bell nozzle at the -x end of the body."""
    throat = float(generator.uniform(0.1, 0.3)) * body.radius
    exit_radius, length = (
        float(generator.uniform(1.8, 3.0)) * throat,
        float(generator.uniform(2.0, 5.0)) * throat,
    )
    mesh = bell(throat, exit_radius, length, sections)
    return Component("nozzle", placed(along_x(mesh), pose((-0.5 * body.length, 0.0, 0.0))), "steel")


def ring(body: MainBody, generator: Generator, *, sections: int) -> Component:
    """Return the ring of a launch adapter at the +x end of the body."""
    radius, height = float(generator.uniform(0.5, 0.85)) * body.radius, float(generator.uniform(0.03, 0.12))
    mesh = trimesh.creation.annulus(
        r_min=float(generator.uniform(0.8, 0.93)) * radius, r_max=radius, height=height, sections=sections
    )
    place = pose((0.5 * body.length + 0.4 * height, 0.0, 0.0))
    return Component("adapter-ring", placed(along_x(mesh), place), "aluminium")


def instrument(number: int, body: MainBody, generator: Generator, *, sections: int) -> Component:
    """Return a box, a baffle or a thruster on the surface of the body."""
    kind = str(generator.choice(("box", "baffle", "thruster")))
    size = float(generator.uniform(0.06, 0.3)) * min(1.0, 2.5 * body.radius)
    stand = facing(*mount(body, generator), float(generator.uniform(0.0, np.pi)))
    if kind == "box":
        sides = size * generator.uniform(0.4, 1.2, 3)
        mesh, height = trimesh.creation.box(extents=sides), float(sides[2])
    elif kind == "baffle":
        height = size * float(generator.uniform(0.5, 1.2))
        mesh = trimesh.creation.annulus(r_min=0.36 * size, r_max=0.4 * size, height=height, sections=sections)
    else:
        height = 0.8 * size
        mesh = placed(
            trimesh.creation.cone(radius=0.3 * size, height=1.6 * size, sections=sections),
            pose((0.0, 0.0, 0.5 * height), Rotation.from_euler("x", np.pi)),
        )
    material = str(generator.choice((*BARE, *FOILS)))
    return Component(f"{kind}-{number}", placed(mesh, stand @ pose((0.0, 0.0, 0.45 * height))), material)


def mount(body: MainBody, generator: Generator) -> tuple[FloatArray, FloatArray]:
    """Return a random place on the body's surface, and the outward normal there, shape (3,) each."""
    points, normals = places(body.core, 1, generator)
    return points[0], normals[0]
