"""A random satellite: its design, drawn by seed and number, and its files."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml
from numpy.random import Generator

from rpod_target.modelling.component import Component, placed
from rpod_target.modelling.files import parts, to_glb
from rpod_target.population import equipment
from rpod_target.population.bodies import KINDS, BodyKind, MainBody, main_body
from rpod_target.population.detail import crinkled, refined, screws
from rpod_target.population.materials import drawn_materials
from rpod_target.population.names import POPULATIONS, PopulationName, name_of, parsed

SIZES_M = (0.2, 60.0)
"""Least and greatest longest side, m; the logarithm is uniform."""
SMALL_SIZES_M = (0.2, 3.0)
"""Limits of the small ones, for a camera that sees a few metres."""
TRIANGLES = (1_000, 200_000)
"""Least and greatest number of triangles; the logarithm is uniform."""
_STREAM = 2026
"""First number in the seeds of all satellites, so that no campaign draws the same random numbers."""
_KIND_SHARES = (0.3, 0.15, 0.15, 0.2, 0.2)
_ARRAYS: tuple[equipment.Arrays, ...] = ("none", "one", "two", "asymmetrical")
_ARRAY_SHARES = (0.15, 0.2, 0.4, 0.25)
_PLAIN_SHARE = 0.12
"""Share of the satellites with an exact symmetry."""
_NEARLY = 0.9
"""Least share of the area that a symmetry maps onto itself, for it to be declared as a near one."""
_MOST_SECTIONS = 64


@dataclass(frozen=True)
class RandomSatellite:
    """A satellite and its files."""

    name: str
    """Name by which ``load_target`` builds it."""
    body: BodyKind
    size_m: float
    """Longest side of its bounding box, m."""
    triangles: int
    """Number of triangles of its mesh file."""
    parameters: str
    """Text of the parameter file (YAML)."""
    meshes: Mapping[str, bytes]
    """Mesh files (GLB), by the names that the parameter file uses."""

    def write(self, folder: Path) -> Path:
        """Write the files into a folder and return the path of the parameter file. Raises OSError."""
        folder.mkdir(parents=True, exist_ok=True)
        for name, content in self.meshes.items():
            (folder / name).write_bytes(content)
        file = folder / f"{self.name}.yaml"
        file.write_text(self.parameters, encoding="utf-8")
        return file


def satellite_of(name: str) -> RandomSatellite | None:
    """Return the satellite of a name; None for any other text."""
    known = parsed(name)
    if known is None:
        return None
    return random_satellite(known.population, seed=known.seed, index=known.number, small=known.small)


@lru_cache(maxsize=2)
def random_satellite(
    population: PopulationName, *, seed: int, index: int, small: bool = False
) -> RandomSatellite:
    """Return a satellite; the same arguments give the same bytes.

    Args:
        population: derive, from which limits may be derived, or report, for reported figures only.
        seed: seed of the population.
        index: number of the satellite, from 0.
        small: whether its longest side is 0.2 to 3 m; everything else equals the satellite that is not small.
    """
    generator = np.random.default_rng((_STREAM, POPULATIONS.index(population), seed, index))
    design = _design(generator, SMALL_SIZES_M if small else SIZES_M)
    return _with_files(name_of(population, seed, index, small=small), design, generator)


@dataclass(frozen=True, eq=False)
class _Design:
    """Components at their size in metres, and their symmetry."""

    body: BodyKind
    components: tuple[Component, ...]
    symmetry: "_Symmetry | None"
    exact: bool
    """Whether the symmetry is exact."""


class _Symmetry(NamedTuple):
    axis: tuple[float, float, float]
    order: int


def _design(generator: Generator, sizes_m: tuple[float, float]) -> _Design:
    kind: BodyKind = KINDS[int(generator.choice(len(KINDS), p=_KIND_SHARES))]
    plain = bool(generator.random() < _PLAIN_SHARE) and kind != "truss"
    arrays = _ARRAYS[int(generator.choice(len(_ARRAYS), p=_ARRAY_SHARES))]
    if plain:
        arrays = "two" if generator.random() < 0.5 else "none"
    low, high = np.log(1.1 * TRIANGLES[0]), np.log(TRIANGLES[1])
    wanted = round(float(np.exp(generator.uniform(low, high))))
    fineness = (np.log(wanted) - low) / (high - low)
    sections = 2 * round(6 + (_MOST_SECTIONS // 2 - 6) * float(fineness))
    body = main_body(kind, generator, sections=sections, regular=plain)
    along = 0.0 if generator.random() < 0.5 else float(generator.uniform(-0.25, 0.25)) * body.length
    components = [
        *body.components,
        *equipment.solar_arrays(arrays, body, generator, plain=plain, along=along, sections=sections),
    ]
    symmetry = _symmetry(body, arrays, plain=plain, along=along)
    if plain:
        components += _axial(body, generator, order=symmetry.order if symmetry else 2)
    else:
        components += _equipment(body, generator, sections=sections)
        symmetry = symmetry if _is_nearly(body, components) else None
        left = wanted - sum(len(each.mesh.faces) for each in components)
        components += screws(body, generator, triangles=int(fineness * left))
    components = refined(components, triangles=wanted)
    if not plain:
        components = [crinkled(each, generator) for each in components]
    return _Design(kind, _sized(components, generator, sizes_m), symmetry, plain)


def _symmetry(body: MainBody, arrays: equipment.Arrays, *, plain: bool, along: float) -> _Symmetry | None:
    """Return the symmetry of a body with its arrays alone, up to the materials of a panel's two sides.

    The plain satellite's two arrays are a half turn about x apart. In all others a half turn about y, the
    direction of the arrays, maps each panel onto itself if the arrays stand at the body's middle.
    """
    if body.kind == "truss":
        return None
    if arrays == "none":
        return _Symmetry((1.0, 0.0, 0.0), min(body.order, _MOST_SECTIONS))
    if plain:
        return _Symmetry((1.0, 0.0, 0.0), 2)
    return _Symmetry((0.0, 1.0, 0.0), 2) if along == 0.0 else None


def _axial(body: MainBody, generator: Generator, *, order: int) -> list[Component]:
    """Return equipment that keeps a symmetry about x of an order, and distinguishes the two ends."""
    sections = order * max(1, round(24 / order))
    found = [equipment.nozzle(body, generator, sections=sections)]
    if generator.random() < 0.6:
        found.append(equipment.ring(body, generator, sections=sections))
    return found


def _equipment(body: MainBody, generator: Generator, *, sections: int) -> list[Component]:
    """Return dishes, booms, nozzle, adapter ring and instruments; at least two of the last."""
    found: list[Component] = []
    for number in range(int(generator.choice(3, p=(0.45, 0.4, 0.15)))):
        found += equipment.dish(number + 1, body, generator, sections=sections)
    for number in range(int(generator.choice(4, p=(0.45, 0.3, 0.15, 0.1)))):
        found += equipment.boom(number + 1, body, generator, sections=sections)
    if generator.random() < 0.5:
        found.append(equipment.nozzle(body, generator, sections=sections))
    if generator.random() < 0.5:
        found.append(equipment.ring(body, generator, sections=sections))
    found += [
        equipment.instrument(number + 1, body, generator, sections=sections)
        for number in range(int(generator.integers(2, 9)))
    ]
    return found


def _is_nearly(body: MainBody, components: Sequence[Component]) -> bool:
    """Return whether nearly all of the surface is that of the body and the arrays."""
    regular = {each.name for each in body.components}
    alike = sum(each.area for each in components if each.name in regular or each.name.startswith("array"))
    return alike >= _NEARLY * sum(each.area for each in components)


def _sized(
    components: Sequence[Component], generator: Generator, sizes_m: tuple[float, float]
) -> tuple[Component, ...]:
    """Return the components scaled so that the longest side is random between the limits."""
    size_m = float(np.exp(generator.uniform(*np.log(sizes_m))))
    low = np.min([each.mesh.bounds[0] for each in components], axis=0)
    high = np.max([each.mesh.bounds[1] for each in components], axis=0)
    scale = size_m / float((high - low).max())
    larger = np.diag((scale, scale, scale, 1.0))
    return tuple(replace(each, mesh=placed(each.mesh, larger)) for each in components)


def _with_files(name: str, design: _Design, generator: Generator) -> RandomSatellite:
    file = f"{name}.glb"
    low = np.min([each.mesh.bounds[0] for each in design.components], axis=0)
    high = np.max([each.mesh.bounds[1] for each in design.components], axis=0)
    materials = drawn_materials(generator)
    used = {each.material for each in design.components}
    density_kg_m3 = float(generator.uniform(20.0, 120.0))
    document: dict[str, Any] = {
        "name": name,
        "mass_kg": float(f"{max(density_kg_m3 * float(np.prod(high - low)), 1e-3):.4g}"),
        "mass_spread": "surface",
        "materials": {
            known: material.model_dump(exclude_defaults=True)
            for known, material in materials.items()
            if known in used
        },
        "parts": parts(design.components, file),
        "distance_field": {},
    }
    if design.symmetry is not None:
        axis, order = design.symmetry
        document["symmetries"] = [{"axis": list(axis), "order": order, "exact": design.exact}]
    return RandomSatellite(
        name=name,
        body=design.body,
        size_m=float((high - low).max()),
        triangles=sum(len(each.mesh.faces) for each in design.components),
        parameters=yaml.safe_dump(document, sort_keys=False, width=110),
        meshes={file: to_glb(design.components)},
    )
