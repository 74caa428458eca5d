"""Prior of a surface's brightness: four classes of albedo, each known only within a wide factor.

An estimator does not know a satellite's reflectances: paint yellows, foil crinkles, and a target's file
follows the drawings. A user can name a class of brightness (``Material.looks``). A class has a median albedo
and a standard deviation of its logarithm:

- dark, grey and white span 0.05 to 0.2, 0.2 to 0.5 and 0.5 to 1; their albedo is the geometric mean of the
  limits. In the widest of them the logarithm has a standard deviation of 0.4. Surfaces that are not
  Lambertian add 0.3, which gives 0.5 in total.
- a mirror reflects into one direction. From other directions it is as dark as black paint (0.05); in a glint
  it is brighter than any diffuse surface. So its logarithm has a standard deviation of about 2.

Parts of the body that share one brightness in an image are its plane faces and its smooth surfaces.
"""

from collections.abc import Mapping
from math import cos, radians
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rpod_schemas.arrays import FloatArray
from rpod_target import Albedo, Target
from rpod_target.mesh.topology import components, edges

PLANES = 50.0
"""Number of steps to which normals and offsets of faces are rounded to find faces in one plane. Numerics: a
degree, and 2 % of the radius; more faces need more steps of the fit."""
SMOOTH_DEG = 30.0
"""Largest angle between neighbouring faces of one surface. Physics: a round body has twelve sides or more."""


class Brightness(NamedTuple):
    """Prior of the albedo of one class, log-normal."""

    albedo: float
    """Median of the Lambertian albedo."""
    sigma_log: float
    """Standard deviation of the albedo's natural logarithm."""


CLASSES: Mapping[Albedo, Brightness] = MappingProxyType(
    {
        "dark": Brightness(0.1, 0.5),
        "grey": Brightness(0.32, 0.5),
        "white": Brightness(0.7, 0.5),
        "mirror": Brightness(0.4, 2.0),
    }
)
"""Priors by the name of the class. Hand: the docstring of the module has limits and spreads."""


def albedos(target: Target) -> FloatArray:
    """Return the median albedo of each triangle's class, shape (T,)."""
    known = np.array([CLASSES[material.looks].albedo for material in target.materials])
    each: FloatArray = known[target.triangle_material]
    return each


def spreads(target: Target) -> FloatArray:
    """Return the standard deviation of the albedo's logarithm of each triangle's class, shape (T,)."""
    known = np.array([CLASSES[material.looks].sigma_log for material in target.materials])
    each: FloatArray = known[target.triangle_material]
    return each


def faces_of(target: Target) -> NDArray[np.int32]:
    """Return the number of the plane face of one material to which each triangle belongs, shape (T,)."""
    normals, triangles_m = np.asarray(target.normals), np.asarray(target.triangles_m)
    offsets = np.einsum("ni,ni->n", normals, triangles_m[:, 0]) / target.radius_m
    steps = np.rint(PLANES * np.column_stack((normals, offsets))).astype(np.int64)
    planes = np.column_stack((steps, target.triangle_material))
    each: NDArray[np.int32] = np.unique(planes, axis=0, return_inverse=True)[1].ravel().astype(np.int32)
    return each


def surfaces_of(target: Target) -> NDArray[np.int32]:
    """Return the number of the smooth surface of one material to which each triangle belongs, shape (T,)."""
    normals, material = np.asarray(target.normals), np.asarray(target.triangle_material)
    _, beside = edges(np.asarray(target.triangles_m))
    one, other = beside.T
    smooth = np.einsum("ni,ni->n", normals[one], normals[other]) > cos(radians(SMOOTH_DEG))
    smooth &= material[one] == material[other]
    found: NDArray[np.int32] = components(beside[smooth], size=len(normals)).astype(np.int32)
    return found
