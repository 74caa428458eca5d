"""Errors of the target's model in the covariance of a pose.

The model's surface may be off by a tolerance. Places near each other are off alike, so that the error does
not average out over their measurements: the surface is divided into cells, and each cell has a displacement
of its own, the same for all residuals in it. Such a displacement is not estimated, only considered (S. F.
Schmidt, Application of State-Space Methods to Navigation Problems, Advances in Control Systems 3, 1966): with
the information I of all residuals, and A that of one cell about its own displacement, the displacement u
moves the pose by I^-1 A u. A residual along a normal depends on a displacement of the surface as on one of
the pose, so that A consists of the first three columns of the cell's own information.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from rpod_schemas.arrays import FloatArray
from rpod_target import Target

CELL = 0.4
"""Size of a cell over the target's longest side: half of the length of a wave of a body that is deformed."""


@dataclass(frozen=True)
class ModelError:
    """How far a target's model may be off."""

    tolerance_m: float
    """Standard deviation of each coordinate of a cell's displacement."""
    scale: float
    """Standard deviation of the share by which the whole model is too large, about the target's origin."""
    cell_m: float
    """Size of a cell."""

    @classmethod
    def of(cls, target: Target) -> Self:
        """Return the errors that a target's file declares."""
        cell_m = CELL * float(np.ptp(target.triangles_m, axis=(0, 1)).max())
        return cls(target.tolerance_m, target.scale_tolerance, cell_m)

    @property
    def matters(self) -> bool:
        """Whether the file declares any error."""
        return self.tolerance_m > 0.0 or self.scale > 0.0

    def cells(self, places_m: FloatArray) -> NDArray[np.intp]:
        """Return the number of the cell of each place, target axes, shape (N, 3), shape (N,), from 0 on."""
        if not len(places_m):
            return np.zeros(0, np.intp)
        corner = np.floor(places_m / self.cell_m).astype(np.int64)
        _, cell = np.unique(corner, axis=0, return_inverse=True)
        return cell.reshape(-1)

    def considered(
        self, covariance: FloatArray, informations: FloatArray, centres_m: FloatArray
    ) -> FloatArray:
        """Return the covariance of the unknowns with the model's errors.

        Args:
            covariance: covariance of (dtau, dtheta, ...) without them, shape (U, U).
            informations: information of each cell's residuals about the unknowns, shape (C, U, U).
            centres_m: middle of each cell's places, target axes, shape (C, 3).
        """
        moved = covariance @ informations[:, :, :3]
        scaled = np.einsum("cij,cj->i", moved, centres_m)
        both: FloatArray = covariance + self.tolerance_m**2 * np.einsum("cij,ckj->ik", moved, moved)
        return both + self.scale**2 * np.outer(scaled, scaled)
