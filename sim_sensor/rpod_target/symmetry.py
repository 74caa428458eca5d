"""Symmetries of a target, found from its surfaces: axes, orders, and how near each turn is.

An axis of symmetry passes through the centre of area. It is a principal axis of the area's second moment or,
where two of its moments are equal, lies among the faces' normals, their sums and their cross products.
Which of the near ones matter depends on what a sensor resolves; that is not decided here.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.spatial.transform import Rotation

from rpod_schemas.arrays import Array, FloatArray
from rpod_target.equivalence import Symmetry
from rpod_target.mesh.topology import areas_m2
from rpod_target.target import Target
from rpod_target.visibility import as_tensor, scene_of

_ORDERS = (2, 3, 4, 5, 6, 7, 8, 9, 10, 12)
_HIGH_ORDERS = (*range(64, 12, -1), 11)
"""Orders that are looked for only about an axis about which any turn is near."""
TURNS = (0.137, 0.291, 0.389)
"""Shares of a full turn, of no low order, that a body of revolution does not show."""
_EXACT, _NEAR = 1e-3, 2e-2
"""Largest distance, over the target's size, of a turned place from the surface: for an exact symmetry, where
it is the largest error of a simplified mesh, and for a place that agrees nearly."""
_SURELY_NOT_EXACT = 2.0 * _EXACT
"""Largest distance of a few turned places from the surface above which a turn is not exact."""
_SAME = 1e-4
"""Largest difference of the largest distances, over the size, of two orders that are equally exact."""
_NEAR_SHARE = 0.6
"""Least share of the places that agree nearly, for a turn at which sensors' views are compared."""
_ALIKE = 0.02
"""Difference of two shares of 1200 places that is within two standard deviations."""
_MOST_NEAR = 12
"""Largest number of near symmetries, the nearest."""
_SAME_FACE = 0.9
"""Least cosine between the normals of a turned place and of the surface there."""
_FEW = 150
"""Number of places that are compared first. If a smaller share than ``_SOME`` of them agrees, no others are
compared."""
_SOME = 0.4
"""Five standard deviations of the share of 150 places below ``_NEAR_SHARE``."""
_REVOLUTION = 12
"""Order that a target's file states for a body of revolution, of which every order is a symmetry."""
_MOST_NORMALS = 14
_SAME_AXIS, _SAME_NEAR_AXIS = np.cos(np.deg2rad((2.0, 15.0)))
"""Cosine of the angle below which two axes are one: of candidates, and of near symmetries of one order."""


@dataclass(frozen=True)
class Likeness:
    """Power of one sensor to distinguish the two poses of a near symmetry, at one apparent size."""

    sensor: str
    condition: str
    """Condition that decides the range: "30 returns", "20% filled"."""
    range_m: float
    """Median range."""
    views: int
    """Number of attitudes that were compared."""
    alike: int
    """Number of these at which one frame does not distinguish the two poses."""
    log_likelihood: float
    """Median of the expected log likelihood by which the right pose wins."""


@dataclass(frozen=True)
class FoundSymmetry:
    """An axis about which turns map a target onto itself, nearly or exactly."""

    axis: tuple[float, float, float]
    """Unit vector along the axis."""
    order: int
    """Number of turns that make a full one."""
    exact: bool
    """Whether surfaces and materials are the same after the turn, within a thousandth of the size.

    Where sensors were asked: whether none of them distinguishes the two poses in any view."""
    share: float
    """Share of the visible surface whose shape agrees after the turn, whatever its material."""
    beside_origin_m: float
    """Distance of the axis from the origin, m; 0 if it is within what agrees.

    A target file can only state axes through the origin."""
    through_m: tuple[float, float, float]
    """Place on the axis, m: the target's centre of area, or the origin."""
    continuous: bool = False
    """Whether the same holds for every turn about the axis: a body of revolution."""
    likeness: tuple[Likeness, ...] = ()
    """Results of sensors for the two poses; empty where none was asked."""
    mistaken: bool = False
    """Whether some sensor, at some range, cannot distinguish the two poses in half of the views, or some turn
    of any in one view."""


def find_symmetries(target: Target) -> list[FoundSymmetry]:
    """Return the exact symmetries of a target, the highest orders first, then the nearest near ones."""
    matcher = _Matcher(target)
    found: list[FoundSymmetry] = []
    for axis in _candidates(target):  # nearly a sphere has a near symmetry of any turn about each of them
        high = sum(one.continuous and not one.exact for one in found) < _MOST_NEAR
        found += _about(matcher, axis, _HIGH_ORDERS if high else ())
    exact = sorted((one for one in found if one.exact), key=lambda one: -one.order)
    near = sorted((one for one in found if not one.exact), key=lambda one: (not one.continuous, -one.share))
    return _without_flips_of_bodies_of_revolution([*exact, *_apart(near, exact)[:_MOST_NEAR]])


def agreeing_share(target: Target, declared: Symmetry) -> float:
    """Return the share of the surface that agrees nearly after the worst of a declared symmetry's turns."""
    matcher, axis = _Matcher(target), np.array(declared.axis)
    matcher.centre_m = np.zeros(3)  # a file states axes through the origin
    if declared.continuous:
        return min(matcher.errors(axis, turn)[1] for turn in TURNS)
    return matcher.errors_of_order(axis, declared.order, above=0.0)[1]


def _apart(near: list[FoundSymmetry], exact: list[FoundSymmetry]) -> list[FoundSymmetry]:
    """Return near symmetries without those whose axis is that of a nearer or exact one, a few degrees off.

    A sensor that aligns the poses sees the exact turn, and would call the one beside it exact too. Two such
    half turns together would make any turn across them one that nobody can distinguish.
    """
    kept: list[FoundSymmetry] = []
    for one in near:
        alike = [other for other in kept if other.continuous == one.continuous and other.order == one.order]
        alike += [other for other in exact if _is_turn_of(one, other)]
        if all(abs(float(np.dot(one.axis, other.axis))) < _SAME_NEAR_AXIS for other in alike):
            kept.append(one)
    return kept


def _is_turn_of(near: FoundSymmetry, exact: FoundSymmetry) -> bool:
    """Return whether the turns of an exact symmetry, about its own axis, have the angles of a near one."""
    return exact.continuous or (not near.continuous and exact.order % near.order == 0)


def _without_flips_of_bodies_of_revolution(found: list[FoundSymmetry]) -> list[FoundSymmetry]:
    """Return one half turn across an axis of any turn or of a high order, instead of all half turns tried."""
    kept: list[FoundSymmetry] = []
    for one in found:
        around = [other.axis for other in kept if other.continuous or other.order > _ORDERS[-1]]
        across = [axis for axis in around if abs(float(np.dot(axis, one.axis))) < 1e-2]
        if not across or not any(other.order == one.order and other.exact >= one.exact for other in kept):
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

    def errors(self, axis: FloatArray, turn: float, *, above: float = 0.0) -> tuple[float, float]:
        """Return the largest distance, over the size, and the share of places that agree nearly.

        The distance is inf where few places agree. With ``above`` of 1 or more, only an exact turn matters;
        a few places are then enough to exclude any other one.
        """
        worst, share = self._errors(axis, turn, self._few)
        if share < _SOME or (above >= 1.0 and worst > _SURELY_NOT_EXACT):
            return np.inf, share
        return self._errors(axis, turn, slice(None))

    def errors_of_order(self, axis: FloatArray, order: int, *, above: float) -> tuple[float, float]:
        """Return the errors of the worst of an order's turns, of which up to four are compared.

        A single step of a high order is a small turn, after which anything looks nearly the same.

        Args:
            axis: unit vector, shape (3,).
            order: number of turns that make a full one.
            above: share that each turn of a near symmetry exceeds; the first that does not is enough.
        """
        worst, share = 0.0, 1.0
        for steps in sorted({1, *(round(turn * order) for turn in TURNS)} - {0}, reverse=True):
            step_worst, step_share = self.errors(axis, steps / order, above=above)
            worst, share = max(worst, step_worst), min(share, step_share)
            if share <= above and worst >= _EXACT:
                break
        return worst, share

    def _errors(self, axis: FloatArray, turn: float, which: slice) -> tuple[float, float]:
        rotation = Rotation.from_rotvec(2.0 * np.pi * turn * axis)
        points_m = rotation.apply(self._target.model_points_m[which] - self.centre_m) + self.centre_m
        normals = rotation.apply(self._target.model_normals[which])
        distance, cosine, material = self._closest(points_m, normals)
        same = material == self._material[which]
        agrees = (distance < _NEAR) & (cosine > _SAME_FACE)
        worst = float(np.quantile(distance, 0.995)) if (same & agrees).mean() > 0.98 else np.inf
        return worst, float(agrees.mean())

    def _closest(self, points_m: FloatArray, normals: FloatArray) -> tuple[FloatArray, FloatArray, Array]:
        """Return distance over size, cosine and material of the nearest surface that faces the same way."""
        lifted = points_m + 0.5 * _NEAR * self.size_m * normals  # prefers the surface that faces the same way
        found = self._scene.compute_closest_points(as_tensor(lifted))
        triangle = found["primitive_ids"].numpy().astype(np.int64)
        distance_m = self._scene.compute_distance(as_tensor(points_m)).numpy()
        cosine = np.einsum("ij,ij->i", self._target.normals[triangle], normals)
        return distance_m / self.size_m, np.abs(cosine), self._target.triangle_material[triangle]


def _about(matcher: _Matcher, axis: FloatArray, high_orders: Sequence[int]) -> Iterator[FoundSymmetry]:
    """Yield the symmetries about an axis: its highest exact order, and near ones of any turn or an order.

    The high orders are tried where any turn is near.
    """
    beside_m = float(np.linalg.norm(matcher.centre_m - axis * (matcher.centre_m @ axis)))
    x, y, z = (float(value) for value in np.round(axis, 9) + 0.0)
    cx, cy, cz = (float(value) for value in matcher.centre_m)

    def one(order: int, share: float, *, exact: bool, continuous: bool = False) -> FoundSymmetry:
        aside_m = beside_m if beside_m > (_EXACT if exact else _NEAR) * matcher.size_m else 0.0
        through_m = (cx, cy, cz) if aside_m else (0.0, 0.0, 0.0)
        return FoundSymmetry((x, y, z), order, exact, share, aside_m, through_m, continuous, mistaken=exact)

    any_turn = [matcher.errors(axis, turn) for turn in TURNS]
    least = min(share for _, share in any_turn)
    if max(worst for worst, _ in any_turn) < _EXACT:
        yield one(_REVOLUTION, least, exact=True, continuous=True)
        return
    around = least > _NEAR_SHARE
    asked = (*high_orders, *_ORDERS[::-1]) if around else _ORDERS[::-1]
    above = least + _ALIKE if around else _NEAR_SHARE
    orders = [(order, *matcher.errors_of_order(axis, order, above=above)) for order in asked]
    least_m = min(worst for _, worst, _ in orders)
    exact = next((each for each in orders if each[1] < min(_EXACT, least_m + _SAME)), None)
    if exact is not None:
        yield one(exact[0], exact[2], exact=True)
    if around:
        yield one(exact[0] if exact else _REVOLUTION, least, exact=False, continuous=True)
    if exact is None:
        most = max(share for _, _, share in orders)
        order, _, share = next(each for each in orders if each[2] > most - _ALIKE)
        if share > above:
            yield one(order, share, exact=False)


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
    corners = [
        one + sign * other + third * last
        for one, other, last in combinations(normals[:4], 3)
        for sign in (1.0, -1.0)
        for third in (1.0, -1.0)
    ]
    crosses = [np.cross(one, other) for one, other in combinations(normals[:6], 2)]
    known: list[FloatArray] = []
    for vector in (*first, *pairs, *corners, *crosses):
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
