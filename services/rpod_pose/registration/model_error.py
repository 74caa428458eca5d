"""Errors of the target's model in the covariance of a pose.

The model's surface may be off by a tolerance. Places near each other have nearly the same error, so that it
does not average out over their measurements. Therefore the surface is divided into cells, and each cell has a
displacement that is the same for all residuals in it. Such a displacement is not estimated, only considered
(S. F. Schmidt, Application of State-Space Methods to Navigation Problems, Advances in Control Systems 3,
1966). With the information I of all residuals, a displacement u of one cell moves the pose by I^-1 A u. A
residual along a normal depends on a displacement of the surface in the same way as on one of the pose. So A
consists of the first three columns of the information of the cell's residuals.

A part of the target is made and mounted as one piece. So no cell lies on two parts, and only a part that is
longer than a cell has several cells.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from rpod_schemas.arrays import FloatArray
from rpod_target import Target
from rpod_target.build.sampling import spread_over
from rpod_target.mesh.topology import areas_m2

CELL = 0.4
"""Size of a cell over the target's longest side. Hand: half of the length of a wave of a body that is
deformed."""
SAMPLES, FEWEST_SAMPLES = 4096, 32
"""Number of points of the surface by which the part of a place is found, and least number on each part.
Numerics: a budget of computation."""


@dataclass(frozen=True, eq=False)
class Parts:
    """The parts of a target, and the division of each into cells."""

    corners_m: FloatArray
    """Least coordinates of each part, shape (P, 3)."""
    counts: NDArray[np.intp]
    """Number of a part's cells along each axis, shape (P, 3)."""
    cells_m: FloatArray
    """Size of a part's cells along each axis, shape (P, 3)."""
    surface: cKDTree
    """Points of the surface, target axes."""
    of_point: NDArray[np.intp]
    """Index of the part of each point of the surface, shape (N,)."""

    @classmethod
    def of(cls, target: Target) -> Self:
        """Return the parts of a target, with cells of at most about ``CELL`` of its longest side."""
        longest_m, whole_m2 = (
            float(np.ptp(target.triangles_m, axis=(0, 1)).max()),
            areas_m2(target.triangles_m),
        )
        corners_m, extents_m = np.zeros((2, len(target.parts), 3))
        points_m, of_point = [], []
        for part in np.unique(target.triangle_part):
            mine = target.triangle_part == part
            mine_m = target.triangles_m[mine]
            corners_m[part], extents_m[part] = mine_m.min(axis=(0, 1)), np.ptp(mine_m, axis=(0, 1))
            number = round(SAMPLES * float(whole_m2[mine].sum() / whole_m2.sum()))
            points_m.append(spread_over(mine_m, max(FEWEST_SAMPLES, number))[0])
            of_point.append(np.full(len(points_m[-1]), part, np.intp))
        counts = np.maximum(np.round(extents_m / (CELL * longest_m)), 1.0).astype(np.intp)
        surface = cKDTree(np.concatenate(points_m))
        return cls(corners_m, counts, np.maximum(extents_m / counts, 1e-9), surface, np.concatenate(of_point))

    def at(self, places_m: FloatArray) -> NDArray[np.intp]:
        """Return the index of the part nearest to each place, (N,); places are in target axes, (N, 3)."""
        found: NDArray[np.intp] = self.of_point[self.surface.query(places_m)[1]]
        return found

    def cells(self, places_m: FloatArray, parts: NDArray[np.intp]) -> NDArray[np.intp]:
        """Return the number of the cell of each place, counted from 0, shape (N,).

        Args:
            places_m: places, target axes, shape (N, 3).
            parts: number of the part of each, shape (N,).
        """
        if not len(places_m):
            return np.zeros(0, np.intp)
        corner = ((places_m - self.corners_m[parts]) / self.cells_m[parts]).astype(np.int64)
        corner = np.clip(corner, 0, self.counts[parts] - 1)
        _, cell = np.unique(np.column_stack((parts, corner)), axis=0, return_inverse=True)
        return cell.reshape(-1)


@dataclass(frozen=True)
class ModelError:
    """Size of the errors that a target's model may have."""

    tolerance_m: float
    """Standard deviation of each coordinate of a cell's displacement."""
    scale: float
    """Relative standard deviation of the size of the whole model, scaled about the target's origin."""

    @classmethod
    def of(cls, target: Target) -> Self:
        """Return the errors that a target's file declares."""
        return cls(target.tolerance_m, target.scale_tolerance)

    @property
    def matters(self) -> bool:
        """Whether the file declares any error."""
        return self.tolerance_m > 0.0 or self.scale > 0.0

    def considered(
        self, covariance: FloatArray, informations: FloatArray, centres_m: FloatArray
    ) -> FloatArray:
        """Return the covariance of the unknowns with the model's errors.

        Args:
            covariance: covariance of (dtau, dtheta, ...) without the model's errors, shape (U, U).
            informations: information of each cell's residuals about the unknowns, shape (C, U, U).
            centres_m: middle of each cell's places, target axes, shape (C, 3).
        """
        moved = covariance @ informations[:, :, :3]
        scaled = np.einsum("cij,cj->i", moved, centres_m)
        both: FloatArray = covariance + self.tolerance_m**2 * np.einsum("cij,ckj->ik", moved, moved)
        return both + self.scale**2 * np.outer(scaled, scaled)
