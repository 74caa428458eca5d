"""Materials of the random satellites: foils, bare metals, paints, solar cells.

The values are assumed, around those of the shipped targets; each satellite draws its own reflectivities.
"""

from collections.abc import Mapping

from numpy.random import Generator

from rpod_target.parameters import MaterialParameters

MATERIALS: Mapping[str, MaterialParameters] = {
    "gold-mli": MaterialParameters(
        reflectivity=0.5, diffuse=0.12, f0=0.75, roughness=0.06, crinkle_deg=3.0, albedo="mirror"
    ),
    "silver-mli": MaterialParameters(
        reflectivity=0.5, diffuse=0.10, f0=0.85, roughness=0.04, crinkle_deg=3.0, albedo="mirror"
    ),
    "black-mli": MaterialParameters(
        reflectivity=0.12, diffuse=0.06, f0=0.1, roughness=0.15, crinkle_deg=3.0, albedo="dark"
    ),
    "aluminium": MaterialParameters(reflectivity=0.5, diffuse=0.25, f0=0.6, roughness=0.25, albedo="mirror"),
    "steel": MaterialParameters(reflectivity=0.4, diffuse=0.2, f0=0.5, roughness=0.3, albedo="mirror"),
    "white-paint": MaterialParameters(reflectivity=0.75, diffuse=0.7, f0=0.04, roughness=0.4, albedo="white"),
    "grey-panel": MaterialParameters(reflectivity=0.35, diffuse=0.35, f0=0.02, roughness=0.3, albedo="grey"),
    "black-paint": MaterialParameters(reflectivity=0.1, diffuse=0.08, f0=0.04, roughness=0.3, albedo="dark"),
    "solar-cells": MaterialParameters(
        reflectivity=0.175, diffuse=0.08, f0=0.04, roughness=0.1, albedo="dark"
    ),
}
"""Materials by name, before each satellite's own variation."""
FOILS = ("gold-mli", "silver-mli", "black-mli")
BARE = ("aluminium", "steel", "white-paint", "grey-panel", "black-paint")
"""Materials without crinkles for bodies and equipment."""
_VARIATION = 0.2
"""Greatest change of a reflectance, as a share of it."""


def drawn_materials(generator: Generator) -> dict[str, MaterialParameters]:
    """Return all materials with reflectances of one satellite; the classes of brightness stay."""
    drawn = {}
    for name, material in MATERIALS.items():
        changes = 1.0 + generator.uniform(-_VARIATION, _VARIATION, 4)
        drawn[name] = material.model_copy(
            update={
                "reflectivity": _share(material.reflectivity * changes[0]),
                "diffuse": _share(material.diffuse * changes[1]),
                "f0": _share(material.f0 * changes[2]),
                "crinkle_deg": round(material.crinkle_deg * float(changes[3]), 4),
            }
        )
    return drawn


def _share(value: float) -> float:
    return round(min(float(value), 0.95), 4)
