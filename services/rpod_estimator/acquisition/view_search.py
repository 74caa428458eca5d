"""Acquisition from one depth image, without a guess: all views and rolls are tried, the best compared.

1. The measured points within the target's radius of their centre are its image; the rest is background.
2. For each view and roll the model's visible centroid is laid on theirs, and a few Gauss-Newton steps in the
   target's distance field draw the model to some of the points.
3. The best distinct poses are refined on more points. The distance field does not see what a pose predicts
   and the image lacks, so it cannot rank them: each is rendered and compared with the image.
4. The turns of the best by the target's near-symmetries are tried too: small details alone tell them apart.
"""

import numpy as np
from numba import njit
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_estimator.ports import Candidate, Candidates
from rpod_estimator.tracking.depth_view import DepthImage, usable_image
from rpod_estimator.tracking.signed_distance import field_arrays, refine
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.pmd_methods import PmdAcquisitionConfig
from rpod_schemas.types import PmdFrame
from rpod_target import Target

GOLDEN_ANGLE = np.pi * (3.0 - np.sqrt(5.0))
BORESIGHT = np.array([0.0, 0.0, 1.0])
SEGMENTATION_ROUNDS = 5


class ViewSearch:
    """Finds the target in a depth image: ports.Search[PmdFrame].

    Raises:
        rpod_target.TargetError: the target has no distance field.
    """

    def __init__(self, config: PmdAcquisitionConfig, target: Target) -> None:
        self._config, self._target, self._field = config, target, field_arrays(target)
        directions = even_directions(config.views)
        rolls = Rotation.from_rotvec(
            np.outer(2.0 * np.pi * np.arange(config.rolls) / config.rolls, BORESIGHT)
        )
        views = [Rotation.align_vectors(-BORESIGHT, direction)[0] for direction in directions]
        self._attitudes = Rotation.concatenate([rolls * view for view in views])
        self._turns = target.turns()
        self._centroids_m = np.repeat(visible_centroids(target, directions), config.rolls, axis=0)

    def search(self, measurement: PmdFrame) -> Candidates:
        """Return distinct candidates, best by render and compare first; empty where no target is in sight."""
        config = self._config
        seen = self._seen(measurement)
        if seen is None:
            return Candidates()
        image, measured_m = seen
        poses, costs = self._drawn_in(measured_m, self._first_guesses(measured_m))
        best = self._compared(image, measured_m, poses[self._distinct(poses, costs, config.kept)])
        turns = [
            best[k].T_sensor_target * turn
            for k in range(min(config.turned, len(best)))
            for turn in self._turns
        ]
        if turns:
            best = best + self._compared(image, measured_m, RigidTransform.concatenate(turns))
        costs = np.array([candidate.cost_m2 for candidate in best])
        poses = RigidTransform.concatenate([candidate.T_sensor_target for candidate in best])
        distinct = self._distinct(poses, costs, config.candidates)
        return Candidates(tuple(best[k] for k in distinct), templates=len(self._attitudes))

    def near(self, measurement: PmdFrame, T_sensor_target: RigidTransform) -> Candidates:
        """Return candidates, best first, from a rough attitude and its turns, laid on the points."""
        seen = self._seen(measurement)
        if seen is None:
            return Candidates()
        image, measured_m = seen
        attitudes = T_sensor_target.rotation * _small_turns(self._config.near_rad)
        centroid_m = measured_m.mean(axis=0)
        directions = attitudes.inv().apply(-centroid_m / np.linalg.norm(centroid_m))
        offsets_m = attitudes.apply(visible_centroids(self._target, directions))
        poses, _ = self._drawn_in(
            measured_m, RigidTransform.from_components(centroid_m - offsets_m, attitudes)
        )
        return Candidates(tuple(self._compared(image, measured_m, poses)), templates=len(attitudes))

    def _seen(self, measurement: PmdFrame) -> tuple[DepthImage, FloatArray] | None:
        """Return the image and the points that are the target's, (N, 3); None where they are too few."""
        image = usable_image(measurement, self._config.image)
        if isinstance(image, str):
            return None
        measured_m = self._segmented(image.points(self._config.fine_points))
        pixels = len(measured_m) * self._config.image.stride_px**2
        return (image, measured_m) if pixels >= self._config.image.min_pixels else None

    def _drawn_in(self, measured_m: FloatArray, guesses: RigidTransform) -> tuple[RigidTransform, FloatArray]:
        """Return the guesses after a few coarse steps on some of the points, and their costs, m2."""
        config = self._config
        coarse_m = measured_m[:: max(1, len(measured_m) // config.coarse_points)]
        scales_m = np.geomspace(config.coarse_scale_m, config.fine_scale_m, config.coarse_iterations)
        return self._refined(coarse_m, guesses, scales_m)

    def _segmented(self, points_m: FloatArray) -> FloatArray:
        """Return the points within the target's radius of their centre, found anew from those within."""
        near = points_m
        for _ in range(SEGMENTATION_ROUNDS if len(points_m) else 0):
            distances_m = np.linalg.norm(points_m - np.median(near, axis=0), axis=1)
            near = points_m[distances_m < self._target.radius_m]
            if not len(near):
                break
        return near

    def _first_guesses(self, measured_m: FloatArray) -> RigidTransform:
        """Return every view and roll about the line of sight to the points, laid on their centroid."""
        centroid_m = measured_m.mean(axis=0)
        to_sight = Rotation.align_vectors(centroid_m / np.linalg.norm(centroid_m), BORESIGHT)[0]
        attitudes = to_sight * self._attitudes
        return RigidTransform.from_components(centroid_m - attitudes.apply(self._centroids_m), attitudes)

    def _refined(
        self, points_m: FloatArray, poses: RigidTransform, scales_m: FloatArray
    ) -> tuple[RigidTransform, FloatArray]:
        """Return the poses after a step for each scale, and their mean Geman-McClure costs, m2."""
        matrices, translations, costs = refine_all(
            points_m, poses.rotation.as_matrix(), poses.translation, self._field, scales_m
        )
        return RigidTransform.from_components(translations, Rotation.from_matrix(matrices)), costs

    def _compared(self, image: DepthImage, points_m: FloatArray, poses: RigidTransform) -> list[Candidate]:
        """Return the poses, refined, with their costs of render and compare, best first."""
        config = self._config
        scales_m = np.geomspace(config.fine_scale_m, config.final_scale_m, config.fine_iterations)
        refined, _ = self._refined(points_m, poses, scales_m)
        candidates = [
            Candidate(pose, image.compare(self._target, pose, config.comparison).cost_m2) for pose in refined
        ]
        return sorted(candidates, key=lambda candidate: candidate.cost_m2)

    def _distinct(self, poses: RigidTransform, costs: FloatArray, count: int) -> list[int]:
        """Return the indices of at most ``count`` poses with distinct attitudes, cheapest first."""
        attitudes = poses.rotation.as_quat()
        nearest = np.cos(self._config.distinct_rad / 2.0)
        kept: list[int] = []
        for index in np.argsort(costs, kind="stable"):
            if not (np.abs(attitudes[kept] @ attitudes[index]) > nearest).any():
                kept.append(int(index))
            if len(kept) == count:
                break
        return kept


@njit(cache=True, nogil=True)
def refine_all(points, matrices, translations, field, scales):  # type: ignore[no-untyped-def]
    """Return ``refine`` of each pose: R, shape (N, 3, 3), t, shape (N, 3), and costs, shape (N,)."""
    costs = np.empty(matrices.shape[0])
    refined, moved = np.empty(matrices.shape), np.empty(translations.shape)
    for n in range(matrices.shape[0]):
        refined[n], moved[n], costs[n] = refine(points, matrices[n], translations[n], field, scales)
    return refined, moved, costs


def even_directions(count: int) -> FloatArray:
    """Return unit vectors spread evenly over the sphere (a Fibonacci lattice), shape (count, 3)."""
    index = np.arange(count)
    z = 1.0 - (2.0 * index + 1.0) / count
    across = np.sqrt(1.0 - z * z)
    return np.column_stack((across * np.cos(GOLDEN_ANGLE * index), across * np.sin(GOLDEN_ANGLE * index), z))


def visible_centroids(target: Target, directions: FloatArray) -> FloatArray:
    """Return the centroid of the pixels that show the target from each direction, shape (N, 3), target axes.

    Model points count by the cosine under which they are seen; what hides behind other parts is let in, since
    the refinement corrects it.
    """
    weights = np.maximum(directions @ target.model_normals.T, 1e-9)
    centroids_m: FloatArray = weights @ target.model_points_m / weights.sum(axis=1, keepdims=True)
    return centroids_m


def _small_turns(angle_rad: float) -> Rotation:
    """Return no turn, and turns both ways about each axis."""
    axes = np.vstack((np.zeros((1, 3)), np.eye(3), -np.eye(3)))
    return Rotation.from_rotvec(angle_rad * axes)
