"""Symmetries of a target, found from its surfaces: axes, orders, and how near each turn is.

An axis of symmetry passes through the centre of area. It is a principal axis of the area's second moment or,
where two of its moments are equal, lies among the faces' normals, their bisectors and their cross products.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.spatial.transform import Rotation

from rpod_schemas.arrays import Array, FloatArray
from rpod_target.target import Target
from rpod_target.topology import areas_m2
from rpod_target.visibility import as_tensor, scene_of

_ORDERS = (2, 3, 4, 5, 6, 7, 8, 9, 10, 12)
_TURNS = np.array([0.137, 0.291, 0.389])
"""Shares of a full turn, of no low order, that a body of revolution does not show."""
_EXACT, _ROUND, _NEAR = 1e-3, 1e-2, 2e-2
"""Largest distance, over the target's size, of a turned place from the surface: for an exact symmetry, for a
body of revolution of flat facets, and for a place that agrees nearly."""
_NEAR_SHARE = 0.9
"""Least share of the places that agree, at a near symmetry."""
_SAME_FACE = 0.9
"""Least cosine between the normals of a turned place and of the surface there."""
_FEW = 150
"""Number of places that are compared first: with fewer than ``_SOME`` of them alike, no others are."""
_SOME = 0.75
"""Six standard deviations of the share of 150 places below ``_NEAR_SHARE``."""
_MOST_NORMALS = 14
_SAME_AXIS = np.cos(np.deg2rad(2.0))


@dataclass(frozen=True)
class FoundSymmetry:
    """An axis about which turns map a target onto itself, nearly or exactly."""

    axis: tuple[float, float, float]
    """Unit vector along the axis."""
    order: int
    """Number of turns that make a full one; 0 if any turn does (a body of revolution)."""
    exact: bool
    """Whether surfaces and materials are the same after the turn, within a thousandth of the size."""
    share: float
    """Share of the visible surface that agrees after the turn."""
    beside_origin_m: float
    """Distance of the axis from the origin, m; a target file can only state axes through the origin."""


def find_symmetries(target: Target) -> list[FoundSymmetry]:
    """Return the symmetries of a target: the exact ones first, then by their order."""
    matcher = _Matcher(target)
    found: list[FoundSymmetry] = []
    for axis in _candidates(target):
        best = _best(matcher, axis)
        if best is not None:
            found.append(best)
    found.sort(key=lambda one: (not one.exact, -(one.order or 1000), -one.share))
    return _without_flips_of_bodies_of_revolution(found)


def _without_flips_of_bodies_of_revolution(found: list[FoundSymmetry]) -> list[FoundSymmetry]:
    """Return one half turn across each axis of revolution instead of all that were tried."""
    kept: list[FoundSymmetry] = []
    for one in found:
        around = [other.axis for other in kept if other.order == 0]
        across = [axis for axis in around if abs(float(np.dot(axis, one.axis))) < 1e-2]
        if not across or not any(other.order == one.order and other.exact == one.exact for other in kept):
            kept.append(one)
    return kept


class _Matcher:
    """Compares the visible surface with itself after a turn about an axis through the centre of area."""

    def __init__(self, target: Target) -> None:
        self.centre_m = _centre_m(target)
        self.size_m = float(np.ptp(target.triangles_m, axis=(0, 1)).max())
        self._scene = scene_of(target.triangles_m)
        self._target = target
        self._material = self._closest(target.model_points_m, target.model_normals)[2]
        self._few = slice(None, None, max(1, len(target.model_points_m) // _FEW))

    def errors(self, axis: FloatArray, turn: float) -> tuple[float, float]:
        """Return the largest distance, over the size, and the share of places that agree nearly.

        The distance is inf where few places agree.
        """
        share = self._errors(axis, turn, self._few)[1]
        return (np.inf, share) if share < _SOME else self._errors(axis, turn, slice(None))

    def _errors(self, axis: FloatArray, turn: float, which: slice) -> tuple[float, float]:
        rotation = Rotation.from_rotvec(2.0 * np.pi * turn * axis)
        points_m = rotation.apply(self._target.model_points_m[which] - self.centre_m) + self.centre_m
        normals = rotation.apply(self._target.model_normals[which])
        distance, cosine, material = self._closest(points_m, normals)
        same = material == self._material[which]
        agrees = (distance < _NEAR) & (cosine > _SAME_FACE)
        worst = float(np.quantile(distance, 0.995)) if (same & agrees).mean() > 0.98 else np.inf
        return worst, float((agrees & same).mean())

    def _closest(self, points_m: FloatArray, normals: FloatArray) -> tuple[FloatArray, FloatArray, Array]:
        """Return distance over size, cosine and material of the surface nearest to places facing alike."""
        lifted = points_m + 0.5 * _NEAR * self.size_m * normals  # prefers the face that looks the same way
        found = self._scene.compute_closest_points(as_tensor(lifted))
        triangle = found["primitive_ids"].numpy().astype(np.int64)
        distance_m = self._scene.compute_distance(as_tensor(points_m)).numpy()
        cosine = np.einsum("ij,ij->i", self._target.normals[triangle], normals)
        return distance_m / self.size_m, np.abs(cosine), self._target.triangle_material[triangle]


def _best(matcher: _Matcher, axis: FloatArray) -> FoundSymmetry | None:
    """Return the highest exact order of an axis, else its highest near one; None without any."""
    beside = float(np.linalg.norm(matcher.centre_m - axis * (matcher.centre_m @ axis)))
    any_turn = [matcher.errors(axis, float(turn)) for turn in _TURNS]

    def one(order: int, share: float, *, exact: bool) -> FoundSymmetry:
        x, y, z = (float(value) for value in np.round(axis, 9) + 0.0)
        return FoundSymmetry(
            (x, y, z), order, exact, share, 0.0 if beside < 1e-3 * matcher.size_m else beside
        )

    if max(worst for worst, _ in any_turn) < _ROUND:
        return one(0, min(share for _, share in any_turn), exact=True)
    tried = [(order, *matcher.errors(axis, 1.0 / order)) for order in _ORDERS]
    exact = [each for each in tried if each[1] < _EXACT]
    near = [each for each in tried if each[2] > _NEAR_SHARE]
    if exact:
        return one(exact[-1][0], exact[-1][2], exact=True)
    if min(share for _, share in any_turn) > _NEAR_SHARE:
        return one(0, min(share for _, share in any_turn), exact=False)
    return one(near[-1][0], near[-1][2], exact=False) if near else None


def _centre_m(target: Target) -> FloatArray:
    """Return the centre of the area of all surfaces, shape (3,)."""
    area = areas_m2(target.triangles_m)
    return np.asarray(area @ target.triangles_m.mean(axis=1) / area.sum())


def _candidates(target: Target) -> Iterator[FloatArray]:
    """Yield unit vectors along which an axis of symmetry may lie, each direction once."""
    area = areas_m2(target.triangles_m)
    middle = target.triangles_m.mean(axis=1) - _centre_m(target)
    moments = np.einsum("t,ti,tj->ij", area, middle, middle)
    normals = _main_normals(target.normals, area)
    first = [*np.eye(3), *np.linalg.eigh(moments)[1].T, *normals]
    pairs = [one + sign * other for one, other in combinations(normals, 2) for sign in (1.0, -1.0)]
    crosses = [np.cross(one, other) for one, other in combinations(normals[:6], 2)]
    known: list[FloatArray] = []
    for vector in (*first, *pairs, *crosses):
        length = float(np.linalg.norm(vector))
        if length < 0.1:
            continue
        axis = vector / length
        axis *= np.sign(axis[np.argmax(np.abs(axis) > 1e-6)])
        if all(abs(float(axis @ other)) < _SAME_AXIS for other in known):
            known.append(axis)
            yield axis


def _main_normals(normals: FloatArray, area: FloatArray) -> list[FloatArray]:
    """Return the directions, up to their sign, that most of the area faces."""
    left = area.copy()
    found: list[FloatArray] = []
    for _ in range(_MOST_NORMALS):
        if left.max() <= 0.0:
            break
        votes = np.argmax(left)
        alike = np.abs(normals @ normals[votes]) > _SAME_AXIS
        found.append(normals[votes])
        left[alike] = 0.0
    return found
