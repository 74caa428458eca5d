"""Comparison of one measurement with thousands of poses of the target, for the searches of all sensors."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rpod_pose.registration.lie_group import PoseArrays
from rpod_pose.search.energy import NOTHING_IN_VIEW, Image, Returns, energies
from rpod_pose.search.view_model import ViewModel, centroids_in_view
from rpod_schemas.arrays import FloatArray
from rpod_schemas.types import Float32Array

FEW_RETURNS, MORE_RETURNS = 64, 256
"""Number of returns in the comparison of all attitudes, and in that of the better ones. Numerics: budgets of
computation."""


@dataclass(frozen=True, eq=False)
class Comparison:
    """A measurement and a target in the forms that ``energies`` needs."""

    views: ViewModel
    seen: Returns
    image: Image
    """Squared angles to the nearest return."""
    detection: tuple[float, FloatArray]
    """Steps of a table per unit of the echo, and the table: share of rays with a return (``energies``)."""
    truncation_m: float
    """Distance at which costs are truncated, equal to that of the views' field, m."""
    truncated: bool = False
    """Whether the target extends beyond the field of view, so that the returns may show any part of it."""

    @cached_property
    def centroid_m(self) -> FloatArray:
        """Centroid of the returns, sensor axes, shape (3,)."""
        centroid_m: FloatArray = self.seen.points_m.mean(axis=0)
        return centroid_m

    def candidates(self, attitudes: Float32Array, *, compared: int, refined: int) -> Iterator[PoseArrays]:
        """Yield rough poses of the target in the sensor, least energy first.

        Args:
            attitudes: R_sensor_target, shape (M, 3, 3); all of them are compared on few points.
            compared: number of the best ones that are compared on all points.
            refined: largest number of poses in the result.
        """
        if self.truncated:  # several positions for each attitude
            attitudes = attitudes[:: len(self.views.anchors_m) // 2]
        attitudes, places_m = self.centroid_aligned(attitudes)
        energy = self.energies(attitudes, places_m, rounds=1, roughly=True)
        better = np.argsort(energy, kind="stable")[:compared]
        attitudes, places_m = attitudes[better], places_m[better]
        energy = self.energies(attitudes, places_m, rounds=2)
        for index in np.argsort(energy, kind="stable")[:refined]:
            if energy[index] < NOTHING_IN_VIEW:
                yield PoseArrays(attitudes[index].astype(np.float64), places_m[index].astype(np.float64))

    def centroid_aligned(self, attitudes: Float32Array) -> tuple[Float32Array, Float32Array]:
        """Return attitudes, shape (K, 3, 3), and first guesses of the target's position, shape (K, 3), m.

        The centroid that the sensor should measure is moved to that of the returns. If the measurement is
        truncated, each attitude is repeated for each region of the target; otherwise K is M.

        Args:
            attitudes: R_sensor_target, shape (M, 3, 3).
        """
        views = self.views
        offsets_m: FloatArray | Float32Array
        if self.truncated:
            offsets_m = np.tile(views.anchors_m, (len(attitudes), 1))
            attitudes = np.repeat(attitudes, len(views.anchors_m), axis=0)
        else:
            offsets_m = centroids_in_view(attitudes, self.centroid_m, views.centroids_m, views.cube)
        places_m = self.centroid_m - (attitudes @ offsets_m[..., None])[..., 0]
        return attitudes, places_m.astype(np.float32)

    def turned(
        self, pose: PoseArrays, turns: FloatArray, count: int, *, sure: int
    ) -> list[tuple[PoseArrays, bool]]:
        """Return a pose after the best of some turns, best first, and whether each is at the centroid.

        The others are at the position of the pose.

        Args:
            pose: the pose.
            turns: rotations of the target, shape (T, 3, 3).
            count: number of poses in the result.
            sure: number of the first turns that are among the best at the pose's position in any case.
        """
        if not len(turns):  # each of them is an exact symmetry, as of a cube
            return []
        turned = (pose.R @ turns).astype(np.float32)
        here = self.energies(turned, np.tile(pose.t, (len(turned), 1)).astype(np.float32), rounds=0)
        here[:sure] = 0.0
        centred, centred_m = self.centroid_aligned(turned)
        energy = self.energies(centred, centred_m, rounds=2).reshape(len(turned), -1)
        best_m = centred_m.reshape(len(turned), -1, 3)[np.arange(len(turned)), energy.argmin(axis=1)]
        order = np.argsort(np.concatenate((here, energy.min(axis=1))), kind="stable")[:count]
        turn, there = order % len(turned), order >= len(turned)
        return [
            (
                PoseArrays(pose.R @ turns[k], best_m[k].astype(np.float64) if centred else pose.t),
                bool(centred),
            )
            for k, centred in zip(turn, there, strict=True)
        ]

    def energies(
        self, attitudes: Float32Array, places_m: Float32Array, *, rounds: int, roughly: bool = False
    ) -> Float32Array:
        """Return the energies of poses, shape (M,), m2, and align their positions with the returns.

        Args:
            attitudes: R_sensor_target, shape (M, 3, 3).
            places_m: positions of the target in the sensor, shape (M, 3); replaced by the aligned ones.
            rounds: number of times that the centroids are aligned.
            roughly: whether only few points and few returns are compared.
        """
        return energies(
            attitudes,
            places_m,
            seen=self.seen,
            points=self.views.few_points if roughly else self.views.points,
            squares=self.views.squares,
            image=self.image,
            detection=self.detection,
            returns=FEW_RETURNS if roughly else MORE_RETURNS,
            rounds=rounds,
            truncation_m=self.truncation_m,
        )
