"""ICP with reverse calibration: matches are found in the depth image, around the projected model.

Klionovska et al., "Close Range Tracking of an Uncooperative Target in a Sequence of PMD Images", Robotics
2018, 7, 5, sections 3.2.1 and 3.2.2 (Figs. 5 and 6, Eq. 4), with two metrics:

``point_to_point`` is the paper's. Each visible model point is projected with the camera's calibration, the
pixels within a radius are searched for the measured point nearest to it, and the rigid motion that minimises
the distances of all pairs follows in closed form. On a plane the nearest neighbours hardly move from step to
step, so that this metric lags behind a rotating target and slides along a surface that is seen obliquely,
until it loses the target.

``point_to_plane`` is the facility's own. If measured points under the model point's pixel and its neighbours
lie close to the model point, only the distance of their mean along the model's normal counts, so that faces
slide freely. If not (background, lost depth, a jump), model and image disagree on an outline. Then the model
point is moved towards its nearest neighbour within the radius, but only along the line between the two: the
outline may slide along itself. These pairs determine the roll about the boresight. Measured points that no
model point matches count by the target's distance field. Weights are robust; radius, direct match and scale
narrow from step to step.
"""

from dataclasses import replace
from math import inf
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_geometry.kernels import inner_kernel, kernel
from rpod_geometry.rays import NEAREST_M
from rpod_pose.pmd.depth_result import Progress, registration_of, size_of
from rpod_pose.pmd.depth_view import DepthImage, DepthView, usable_image
from rpod_pose.pmd.signed_distance import measured_equations
from rpod_pose.ports import Registration
from rpod_pose.registration.field_alignment import FieldEvidence
from rpod_pose.registration.lie_group import Vector, moved, step_between, step_length_m
from rpod_pose.registration.normal_equations import (
    NormalEquations,
    add_residual,
    geman_mcclure,
    no_sums,
)
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.pmd.lengths import MatchLengths, relative_size
from rpod_schemas.config.pmd.methods import IcpReverseCalibrationConfig
from rpod_schemas.types import Float32Array, PmdFrame, Source
from rpod_target import Target

NO_MATCH, DIRECT, NEAREST = 0, 1, 2
"""How a model point found its pixel: not at all, in its own pixel, or in the nearest with depth. Numerics:
small whole numbers, compared for equality only."""
STALE_M = 0.01
"""Least step after which the visible model points of the mock-up are determined again; for others it is in
proportion. Hand: visibility changes little below it; a smaller value costs time."""
EQUAL_WEIGHTS_M = 1e3
"""A Geman-McClure scale at which all matches have the same weight. Numerics: weights then differ by some
millionths."""
FEWEST_BENEATH = 2
"""Least number of points in a direct match. Hand: one point is too noisy, and near an outline it may be
mixed."""
NARROWING = 0.75
"""Factor on radius and scale from iteration to iteration. Numerics: a larger factor converges from farther,
slower."""


class DepthPixels(NamedTuple):
    """A depth image, as the kernels take it."""

    depth_m: Float32Array
    """z-depth, NaN without one, shape (height, width)."""
    slopes: FloatArray
    """x/z and y/z of the pixels' rays, shape (height, width, 2)."""


@inner_kernel
def mean_beneath(point: FloatArray, column: int, row: int, image: DepthPixels, near: float) -> Vector:
    """Return the mean of the measured points under a pixel and its neighbours that lie near a point.

    Args:
        point: model point, sensor axes, shape (3,), m.
        column: column of the pixel, in the image.
        row: row of the pixel, in the image.
        image: measured depth image.
        near: distance from ``point`` below which a measured point counts, m.

    Returns:
        The mean, sensor axes, m; zeros if fewer than ``FEWEST_BENEATH`` points count.
    """
    depth, slopes = image
    top, bottom = max(row - 1, 0), min(row + 2, depth.shape[0])
    left, right = max(column - 1, 0), min(column + 2, depth.shape[1])
    x, y, z, count = 0.0, 0.0, 0.0, 0
    for v in range(top, bottom):
        for u in range(left, right):
            d = depth[v, u]
            px, py = slopes[v, u, 0] * d, slopes[v, u, 1] * d
            if (px - point[0]) ** 2 + (py - point[1]) ** 2 + (d - point[2]) ** 2 < near * near:
                x, y, z, count = x + px, y + py, z + d, count + 1
    if count < FEWEST_BENEATH:
        return Vector(0.0, 0.0, 0.0)
    return Vector(x / count, y / count, z / count)


class MatchReach(NamedTuple):
    """Limits of the search for matches."""

    radius_px: int
    """Radius of the neighbour search."""
    direct_m: float
    """Largest distance of points in a direct match; 0 for the neighbour search always."""
    gate_m: float
    """Largest length of a match."""


@kernel
def find_matches(
    points: FloatArray, pixels: FloatArray, image: DepthPixels, reach: MatchReach
) -> tuple[FloatArray, NDArray[np.uint8]]:
    """Return the measured point of each model point, shape (N, 3), m, and how it was found, shape (N,).

    Source: Klionovska et al. 2018, section 3.2.1, Figs. 5 and 6.

    Args:
        points: model points in sensor axes, (N, 3), m.
        pixels: their projections, column and row, (N, 2); one that is not in the image has no match.
        image: measured depth image.
        reach: limits of the search.
    """
    depth, slopes = image
    radius, gate = reach.radius_px, reach.gate_m
    height, width = depth.shape
    matched, kind = np.zeros(points.shape), np.zeros(points.shape[0], np.uint8)
    for n in range(points.shape[0]):
        u0, v0 = pixels[n, 0], pixels[n, 1]
        if not (-1.0 < u0 < width and -1.0 < v0 < height):  # also true for NaN and beyond integers
            continue
        column, row = round(u0), round(v0)
        if not (0 <= column < width and 0 <= row < height):
            continue
        x, y, z = points[n]
        beneath = mean_beneath(points[n], column, row, image, reach.direct_m)
        if beneath.z > 0.0:
            matched[n, 0], matched[n, 1], matched[n, 2] = beneath
            kind[n] = DIRECT
            continue
        if column < radius or row < radius or column + radius >= width or row + radius >= height:
            continue  # the neighbourhood is cut by the image's border: the nearest point may lie beyond it
        best = gate * gate
        for v in range(row - radius, row + radius + 1):
            half = int(np.sqrt(radius * radius - (v - row) ** 2))
            for u in range(column - half, column + half + 1):
                d = depth[v, u]
                distance = (slopes[v, u, 0] * d - x) ** 2 + (slopes[v, u, 1] * d - y) ** 2 + (d - z) ** 2
                if distance < best:
                    best = distance
                    matched[n, 0], matched[n, 1], matched[n, 2] = slopes[v, u, 0] * d, slopes[v, u, 1] * d, d
                    kind[n] = NEAREST
    return matched, kind


class Pairs(NamedTuple):
    """Visible model points with their matches."""

    model_m: FloatArray
    """Model points, target axes, shape (N, 3)."""
    normals: FloatArray
    """Normals at the model points, target axes, shape (N, 3)."""
    measured_m: FloatArray
    """Measured points, sensor axes, or target axes in ``match_equations``, shape (N, 3)."""
    kind: NDArray[np.uint8]
    """Kind of each match: NO_MATCH, DIRECT or NEAREST, shape (N,)."""

    @property
    def found(self) -> int:
        """Number of model points that have a match."""
        return int(np.count_nonzero(self.kind))

    def equations(
        self, T_sensor_target: RigidTransform, *, scale_m: float, outline_weight: float
    ) -> NormalEquations:
        """Return the normal equations at a pose."""
        in_target = self._replace(measured_m=T_sensor_target.inv().apply(self.measured_m))
        sums, found = match_equations(in_target, scale_m, outline_weight)
        return NormalEquations.of(
            sums, weight=found.weight, squares_m2=found.squares_m2, inliers=found.inliers
        )

    def best_motion(self) -> RigidTransform:
        """Return the pose with the least sum of the pairs' squared distances (Eq. 4; Kabsch's solution)."""
        found = self.kind != NO_MATCH
        model, measured = self.model_m[found], self.measured_m[found]
        U, _, Vt = np.linalg.svd((measured - measured.mean(axis=0)).T @ (model - model.mean(axis=0)))
        R = Rotation.from_matrix(U @ np.diag((1.0, 1.0, np.linalg.det(U @ Vt))) @ Vt)
        return RigidTransform.from_components(measured.mean(axis=0) - R.apply(model.mean(axis=0)), R)


@kernel
def match_equations(pairs: Pairs, scale: float, outline_weight: float) -> tuple[FloatArray, FieldEvidence]:
    """Return the sums, shape (35,), of residuals along the normal, or along the match, and their evidence.

    Args:
        pairs: N model points with their matches, target axes.
        scale: Geman-McClure scale, m, above 0.
        outline_weight: weight of a nearest match relative to a direct one.
    """
    sums, weights, squares, inliers, c2 = no_sums(), 0.0, 0.0, 0, scale * scale
    for n in range(pairs.model_m.shape[0]):
        if pairs.kind[n] == NO_MATCH:
            continue
        s, axis = pairs.measured_m[n], pairs.normals[n]
        e = s - pairs.model_m[n]
        relative = 1.0
        if pairs.kind[n] == NEAREST:
            axis, relative = e / max(np.sqrt((e * e).sum()), 1e-9), outline_weight
        residual = (axis * e).sum()
        weight = relative * geman_mcclure(residual * residual, c2)
        normal, place = Vector(axis[0], axis[1], axis[2]), Vector(s[0], s[1], s[2])
        add_residual(sums, normal, place, residual, weight)
        weights += weight
        if residual * residual < c2:
            inliers += 1
            squares += residual * residual
    return sums, FieldEvidence(weights, squares, inliers, float(inliers))


class ReverseCalibrationIcp:
    """Registers depth images by ICP with reverse calibration: ports.Tracker[PmdFrame].

    Raises:
        rpod_target.TargetError: ``cover_points`` is above 0 and the target has no distance field.
    """

    def __init__(self, config: IcpReverseCalibrationConfig, target: Target) -> None:
        self._config, self._target = config, target
        self._size = relative_size(target.radius_m, inf)
        self._slides = config.metric == "point_to_plane"
        if self._slides and config.cover_points:
            target.require_field()

    def track(self, measurement: PmdFrame, T_sensor_target: RigidTransform) -> Registration:
        """Return the registration from a predicted pose, or the reason why the frame gives none."""
        config = self._config
        image = usable_image(measurement, config.image)
        if isinstance(image, str):
            return Registration.none(Source.PMD_DEPTH, image)
        measured_m = image.points(config.cover_points if self._slides else 0)
        size = size_of(self._target, image)
        lengths = config.match_lengths(size)
        progress, shown = Progress(T_sensor_target), np.empty(0, np.intp)
        while progress.iterations < config.iterations and not self._converged(progress, lengths):
            if progress.step_m > STALE_M * size:
                shown = self._shown(image.view, progress.T_sensor_target)
            progress = self._advanced(progress, image, shown, measured_m, lengths)
        return registration_of(progress, image, self._target, config)

    def _width(self, iteration: int) -> float:
        """Return the factor on the initial radius, direct match and scale in an iteration."""
        return max(NARROWING**iteration, self._config.final_share) if self._slides else 1.0

    def _converged(self, progress: Progress, lengths: MatchLengths) -> bool:
        config = self._config
        wide = self._slides and self._width(progress.iterations - 1) > config.final_share
        small = progress.step_m < lengths.step_m or progress.sums.cost_m2 < config.error_m2
        return bool(progress.reason) or (small and not wide)

    def _shown(self, view: DepthView, T_sensor_target: RigidTransform) -> NDArray[np.intp]:
        """Return the indices of the model points that are visible to the camera at a pose."""
        target = self._target
        camera_m = T_sensor_target.inv().translation
        sight_m = camera_m - target.model_points_m
        cosine = (sight_m * target.model_normals).sum(axis=1) / np.linalg.norm(sight_m, axis=1)
        facing = cosine > self._config.min_cosine
        points_m = T_sensor_target.apply(target.model_points_m)
        shown = np.flatnonzero(facing & (points_m[:, 2] > NEAREST_M))
        pixels = view.project(points_m[shown])
        rendered_m = view.render(target, T_sensor_target)
        return shown[view.inside(pixels) & ~view.hidden(rendered_m, points_m[shown], pixels, size=self._size)]

    def _advanced(
        self,
        progress: Progress,
        image: DepthImage,
        shown: NDArray[np.intp],
        measured_m: FloatArray,
        lengths: MatchLengths,
    ) -> Progress:
        """Return the progress after one more iteration."""
        T, width = progress.T_sensor_target, self._width(progress.iterations)
        pairs = self._paired(image, shown, T, width, lengths)
        if pairs.found < self._config.min_matches:
            reason = f"{pairs.found} model points matched, {self._config.min_matches} needed"
            return replace(progress, reason=reason)
        if self._slides:
            scale_m = width * lengths.scale_m
            sums = pairs.equations(T, scale_m=scale_m, outline_weight=self._config.outline_weight)
            sums += measured_equations(self._target, measured_m, T, scale_m)
            step = sums.step()
        else:
            sums = pairs.equations(T, scale_m=EQUAL_WEIGHTS_M, outline_weight=1.0)
            step = step_between(T, pairs.best_motion())
        return Progress(
            moved(T, step),
            sums=sums,
            points=len(shown) + len(measured_m),
            step_m=step_length_m(step, self._target.radius_m),
            iterations=progress.iterations + 1,
        )

    def _paired(
        self,
        image: DepthImage,
        shown: NDArray[np.intp],
        T_sensor_target: RigidTransform,
        width: float,
        lengths: MatchLengths,
    ) -> Pairs:
        """Return the visible model points with their matches."""
        config = self._config
        model_m = self._target.model_points_m[shown]
        points_m = np.ascontiguousarray(T_sensor_target.apply(model_m))  # the kernel is compiled once
        direct_m = width * lengths.direct_m if self._slides else 0.0
        measured_m, kind = find_matches(
            points_m,
            image.view.project(points_m),
            DepthPixels(image.depth_m, image.view.slopes),
            MatchReach(round(width * config.radius_px), direct_m, lengths.gate_m),
        )
        return Pairs(model_m, self._target.model_normals[shown], measured_m, kind)
