"""The wireframe of a target at one pose: the lines, corners and circles to search in an image.

Klionovska et al., Robotics 7(1), 2018, sections 3.1 and 3.3.1: the front hexagon and the extreme point of
the nose. Which face is the front follows from the pose: the largest one that is seen.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from rpod_geometry.rays import NEAREST_M
from rpod_pose.pmd.depth_view import DepthView
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.pmd.lengths import relative_size
from rpod_target import Target
from rpod_target.outlines import Disc, Face, plane_faces

BESIDE_STRIDES = 1.5
"""Distance from a line, in coarse pixels, at which the background is checked. Hand: past the coarse pixel in
which the line is."""
KNOTS = np.linspace(0.04, 0.96, 12)
"""Positions along a line, or around a rim, at which its visibility is checked. Numerics: a budget; the ends
belong to other lines too."""
SAME_CORNER = 1e-5
"""Largest distance of two equal corners, as a share of the target's extent. Numerics: the rounding of a mesh
in single precision."""
PARALLEL = 0.99
"""Least cosine of the angle between normals that count as parallel. Hand: 8 deg."""
AXIS_SHARE = 0.01
"""Largest distance of two equal axes of circles, as a share of the radius. Hand: far above rounding, below
the distance of two parts."""
RIM = np.stack([np.cos(2.0 * np.pi * KNOTS), np.sin(2.0 * np.pi * KNOTS)], axis=1)
"""These positions on a unit circle, shape (12, 2). Physics: of ``KNOTS``."""


@dataclass(frozen=True, eq=False)
class Wireframe:
    """Corners of a target's plane faces and the lines between them."""

    corners_m: FloatArray
    """Corners, target axes, shape (C, 3)."""
    lines: NDArray[np.int64]
    """Indices of each line's two corners, shape (L, 2)."""
    of_face: NDArray[np.bool_]
    """Which lines bound each face, shape (F, L)."""

    @classmethod
    def of(cls, faces: Sequence[Face]) -> Self:
        """Return the wireframe of faces, with equal corners and equal lines merged."""
        if not faces:
            return cls(np.empty((0, 3)), np.empty((0, 2), np.int64), np.empty((0, 0), bool))
        corners_m = np.concatenate([face.corners_m for face in faces])
        grain_m = SAME_CORNER * float(np.ptp(corners_m, axis=0).max())
        _, first, index = np.unique(
            np.rint(corners_m / grain_m), axis=0, return_index=True, return_inverse=True
        )
        index = index.reshape(-1)
        number = np.repeat(np.arange(len(faces)), [len(face.corners_m) for face in faces])
        own = [index[number == face] for face in range(len(faces))]
        ends = np.concatenate([np.stack((corner, np.roll(corner, -1)), axis=1) for corner in own])
        lines, line = np.unique(np.sort(ends, axis=1), axis=0, return_inverse=True)
        of_face = np.zeros((len(faces), len(lines)), bool)
        of_face[number, line.reshape(-1)] = True
        return cls(corners_m[first], lines, of_face)


@dataclass(frozen=True, eq=False)
class Shown:
    """The part of a wireframe that is visible at one pose."""

    lines: NDArray[np.int64]
    """Indices of the visible lines, shape (K,)."""
    silhouette: NDArray[np.bool_]
    """Whether each of these lines has background on one side, shape (K,)."""
    discs: tuple[Disc, ...]
    """The visible circles."""


class WireframeView:
    """A target's faces and circles, and which of them are visible at a pose.

    Args:
        target: target whose plane faces make the wireframe.
        only_front: whether only the largest visible face and the circles of the nose in front of it are used.
        min_face_share: least area of a face with lines, as a share of the largest face's.
        min_seen_share: least visible share of a line or circle that is used.
    """

    def __init__(
        self, target: Target, *, only_front: bool, min_face_share: float, min_seen_share: float
    ) -> None:
        self._target, self._only_front, self._min_seen_share = target, only_front, min_seen_share
        self._size = relative_size(target.radius_m, inf)
        faces, discs = plane_faces(target, min_area_m2=0.0)
        self._faces = [face for face in faces if face.area_m2 >= min_face_share * faces[0].area_m2]
        self._discs = [nose_discs(face, discs) for face in self._faces] if only_front else [discs]
        self.wireframe = Wireframe.of(self._faces)

    def shown(self, T_sensor_target: RigidTransform, view: DepthView) -> Shown | str:
        """Return the part of the wireframe that a camera sees at a pose, or why it sees nothing."""
        eye_m = T_sensor_target.inv().translation
        towards = np.array([(eye_m - face.corners_m[0]) @ face.normal > 0.0 for face in self._faces], bool)
        if not towards.any():
            return "the target has no plane face towards the camera"
        front = int(towards.argmax())  # faces are sorted by their area
        lines = np.flatnonzero(
            self.wireframe.of_face[front] if self._only_front else self.wireframe.of_face[towards].any(axis=0)
        )
        discs = [
            disc
            for disc in self._discs[front if self._only_front else 0]
            if (eye_m - disc.centre_m) @ disc.normal > 0.0
        ]
        ends_m = self.wireframe.corners_m[self.wireframe.lines[lines]]
        along_m = ends_m[:, None, 0] + KNOTS[:, None] * (ends_m[:, None, 1] - ends_m[:, None, 0])
        around_m = [rim_m(disc, RIM)[None] for disc in discs]
        rendered_m = view.render(self._target, T_sensor_target)
        seen = self._seen(np.concatenate((along_m, *around_m)), T_sensor_target, view, rendered_m)
        shown = seen[: len(lines)]
        return Shown(
            lines[shown],
            _before_background(T_sensor_target.apply(ends_m[shown].reshape(-1, 3)), view, rendered_m),
            tuple(disc for disc, is_seen in zip(discs, seen[len(lines) :], strict=True) if is_seen),
        )

    def _seen(
        self, points_m: FloatArray, T_sensor_target: RigidTransform, view: DepthView, rendered_m: FloatArray
    ) -> NDArray[np.bool_]:
        """Return which rows of points, target axes, shape (rows, knots, 3), are visible enough, (rows,)."""
        at_m = T_sensor_target.apply(points_m.reshape(-1, 3))
        ahead = at_m[:, 2] > NEAREST_M
        at_m[~ahead, 2] = NEAREST_M
        pixels = view.project(at_m)
        shown = ahead & view.inside(pixels) & ~view.hidden(rendered_m, at_m, pixels, size=self._size)
        enough: NDArray[np.bool_] = shown.reshape(points_m.shape[:2]).mean(axis=1) >= self._min_seen_share
        return enough


def _before_background(ends_m: FloatArray, view: DepthView, rendered_m: FloatArray) -> NDArray[np.bool_]:
    """Return which lines, by their ends in sensor axes, shape (2 K, 3), have background along one side."""
    ends_m[:, 2] = np.maximum(ends_m[:, 2], NEAREST_M)
    ends = view.project(ends_m).reshape(-1, 2, 2)
    way = ends[:, 1] - ends[:, 0]
    along = way / np.maximum(np.sqrt((way**2).sum(axis=1, keepdims=True)), 1e-9)
    aside = BESIDE_STRIDES * view.stride * np.stack((-along[:, 1], along[:, 0]), axis=1)
    middle = ends[:, None, 0] + KNOTS[:, None] * way[:, None]
    empty = np.isinf(rendered_m)
    shares = [
        empty[_cells(middle + side * aside[:, None], view, empty.shape)].mean(axis=1) for side in (-1, 1)
    ]
    background: NDArray[np.bool_] = np.max(shares, axis=0) > 0.5
    return background


def _cells(
    pixels: FloatArray, view: DepthView, shape: tuple[int, ...]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the rows and columns of the coarse pixels nearest to pixels, shape (..., 2)."""
    nearest = np.rint((np.clip(pixels, -1e6, 1e6) - view.offset) / view.stride).astype(np.intp)
    return np.clip(nearest[..., 1], 0, shape[0] - 1), np.clip(nearest[..., 0], 0, shape[1] - 1)


def nose_discs(face: Face, discs: list[Disc]) -> list[Disc]:
    """Return the outermost circle among those parallel to a face and in front of it; empty if there is none.

    Circles about the same axis are included: where light saturates, the visible rim is that of a step behind
    the nose's end.
    """
    centre_m = face.corners_m.mean(axis=0)
    reach_m = float(np.linalg.norm(face.corners_m - centre_m, axis=1).max())

    def height_m(disc: Disc) -> float:
        return float((disc.centre_m - centre_m) @ face.normal)

    def beside_m(disc: Disc, point_m: FloatArray) -> float:
        offset_m = disc.centre_m - point_m
        return float(np.linalg.norm(offset_m - (offset_m @ face.normal) * face.normal))

    before = [
        disc
        for disc in discs
        if disc.normal @ face.normal > PARALLEL
        and height_m(disc) > 0.0
        and beside_m(disc, centre_m) < reach_m
    ]
    if not before:
        return []
    nose = max(before, key=height_m)
    return [disc for disc in before if beside_m(disc, nose.centre_m) < AXIS_SHARE * nose.radius_m]


def plane_axes(normal: FloatArray) -> FloatArray:
    """Return two unit vectors perpendicular to a normal and to each other, shape (2, 3)."""
    basis, _ = np.linalg.qr(np.column_stack((normal, np.eye(3))))
    return np.ascontiguousarray(basis[:, 1:3].T)


def rim_m(disc: Disc, circle: FloatArray) -> FloatArray:
    """Return the points of a disc's rim, shape (N, 3), m, at points of the unit circle, shape (N, 2)."""
    points_m: FloatArray = disc.centre_m + disc.radius_m * circle @ plane_axes(disc.normal)
    return points_m
