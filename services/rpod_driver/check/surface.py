"""The surface of a target as points with normals, for comparing a sensor with truth."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

from scipy.spatial import KDTree

from rpod_schemas.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class Surface:
    """Even samples of a target's surface, target axes."""

    points_m: FloatArray
    """Shape (N, 3)."""
    normals: FloatArray
    """Outward unit normals, shape (N, 3)."""
    radius_m: float
    """Radius of the sphere about the origin that holds the target."""

    @classmethod
    def of(cls, target: Any) -> "Surface":
        """Return the surface of an ``rpod_target.Target`` whose joints are at 0."""
        return cls(target.model_points_m, target.model_normals, float(target.radius_m))

    @cached_property
    def tree(self) -> KDTree:
        """Search tree of the points."""
        return KDTree(self.points_m)
