"""Centre of mass and inertia of a target from its surfaces and one mass or density."""

from typing import Literal, NamedTuple

import numpy as np

from rpod_schemas.arrays import FloatArray
from rpod_target.topology import areas_m2


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
    volume_m3, first, second = _volume_moments(solid_m) if len(solid_m) else (0.0, np.zeros(3), np.eye(3))
    if density_kg_m3 is not None:
        if volume_m3 <= 0.0:
            raise ValueError("needs a closed surface, and there is none: give mass_kg instead")
        mass_kg = density_kg_m3 * volume_m3
    if mass_kg is None:
        raise ValueError("give mass_kg or density_kg_m3")
    size = volume_m3
    if spread == "surface" or volume_m3 <= 0.0:
        size, first, second = _area_moments(surface_m)
    centre_m = first / size
    covariance = second / size - np.outer(centre_m, centre_m)
    inertia = mass_kg * (np.trace(covariance) * np.eye(3) - covariance)
    return MassProperties(mass_kg, centre_m, 0.5 * (inertia + inertia.T))


def _volume_moments(triangles_m: FloatArray) -> tuple[float, FloatArray, FloatArray]:
    """Return volume, first and second moment about the origin, as sums over tetrahedra to the origin."""
    determinant = np.einsum("ij,ij->i", triangles_m[:, 0], np.cross(triangles_m[:, 1], triangles_m[:, 2]))
    corner_sum = triangles_m.sum(axis=1)
    first = np.einsum("t,ti->i", determinant, corner_sum) / 24.0
    second = np.einsum("t,tci,tcj->ij", determinant, triangles_m, triangles_m)
    second += np.einsum("t,ti,tj->ij", determinant, corner_sum, corner_sum)
    return float(determinant.sum() / 6.0), first, second / 120.0


def _area_moments(triangles_m: FloatArray) -> tuple[float, FloatArray, FloatArray]:
    """Return area, first and second moment about the origin."""
    area = areas_m2(triangles_m)
    corner_sum = triangles_m.sum(axis=1)
    first = np.einsum("t,ti->i", area, corner_sum) / 3.0
    second = np.einsum("t,tci,tcj->ij", area, triangles_m, triangles_m)
    second += np.einsum("t,ti,tj->ij", area, corner_sum, corner_sum)
    return float(area.sum()), first, second / 12.0
