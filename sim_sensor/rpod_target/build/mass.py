"""Centre of mass and inertia of a target from its surfaces and one mass or density, by trimesh."""

from typing import Literal, NamedTuple

import numpy as np

from rpod_schemas.arrays import FloatArray
from rpod_target.mesh.topology import areas_m2, volume_m3


class MassProperties(NamedTuple):
    """Mass properties of an even spread of mass."""

    mass_kg: float
    centre_m: FloatArray
    """Centre of mass, shape (3,)."""
    inertia_kg_m2: FloatArray
    """Inertia about the centre of mass, shape (3, 3)."""


def mass_properties(
    solid_m: FloatArray,
    surface_m: FloatArray,
    *,
    mass_kg: float | None,
    density_kg_m3: float | None,
    spread: Literal["volume", "surface"],
) -> MassProperties:
    """Return the mass properties of parts with an even density.

    Where closed surfaces overlap, their volume counts twice; a cavity, which faces inwards, is subtracted.

    Args:
        solid_m: triangles of the closed surfaces, shape (S, 3, 3).
        surface_m: triangles of all surfaces, shape (T, 3, 3).
        mass_kg: the whole mass; None if a density is given.
        density_kg_m3: mass of a volume; on surfaces it only gives the whole mass.
        spread: whether the mass is in the volume or on the area.

    Raises:
        ValueError: a density is given, and no surface is closed.
    """
    from trimesh.inertia import points_inertia  # noqa: PLC0415 - only a build needs it
    from trimesh.triangles import mass_properties as solid_properties  # noqa: PLC0415

    volume = volume_m3(solid_m) if len(solid_m) else 0.0
    if density_kg_m3 is not None:
        if volume <= 0.0:
            raise ValueError("needs a closed surface, and there is none: give mass_kg (--mass-kg) instead")
        mass_kg = density_kg_m3 * volume
    if mass_kg is None:
        raise ValueError("give mass_kg or density_kg_m3")
    if spread == "volume" and volume > 0.0:
        solid = solid_properties(solid_m, density=mass_kg / volume)
        return MassProperties(mass_kg, np.asarray(solid.center_mass), np.asarray(solid.inertia))
    # a third of a triangle's mass in the middle of each side has the moments of the triangle
    middles_m = 0.5 * (surface_m + np.roll(surface_m, -1, axis=1)).reshape(-1, 3)
    weights_kg = np.repeat(areas_m2(surface_m), 3)
    weights_kg *= mass_kg / weights_kg.sum()
    centre_m = np.asarray(weights_kg @ middles_m / mass_kg)
    return MassProperties(mass_kg, centre_m, points_inertia(middles_m, weights_kg))
