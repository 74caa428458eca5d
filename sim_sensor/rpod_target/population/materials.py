"""Materials of the random satellites, each of which draws its own reflectivities."""

from numpy.random import Generator

from rpod_target.modelling.materials import MATERIALS
from rpod_target.parameters import MaterialParameters

FOILS = ("gold-mli", "silver-mli", "black-mli")
BARE = ("aluminium", "steel", "white-paint", "grey-panel", "black-paint")
"""Materials without crinkles for bodies and equipment."""
_VARIATION = 0.2
"""Largest change of a reflectance, as a share of it."""


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
