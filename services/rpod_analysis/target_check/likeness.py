"""Near symmetries that sensors do not resolve: predicted frames of two poses, compared against the noise.

A turn is a near symmetry if one frame may not distinguish the turned pose from the right one. For each
sensor, at the ranges of ``conditions``, the target is cast at a pose and at the turned one, which is first
shifted and turned by the least-squares step that brings the two together. A ray that meets both has the log
likelihood ratio d^2 / (2 s^2): d is the part of the range difference that exceeds the systematic errors of
model and sensor, and s the noise of emulated frames; d / s is at most three. A ray that meets only one of
them, or surfaces of different brightness in a camera, has the greatest ratio. Outlines and steps of the range
may differ by one ray. The sum, times the share of rays that an emulated frame measures, is the mean by which
the right pose wins.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, minimum_filter
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_analysis.target_check.conditions import Condition, conditions
from rpod_analysis.target_check.emulated import EmulatedKind
from rpod_geometry.rays import RayGrid, cast
from rpod_geometry.windows import window_around
from rpod_schemas.arrays import MAD_TO_SIGMA, FloatArray
from rpod_schemas.config.lidar import LidarConfig
from rpod_schemas.config.pmd import PmdConfig
from rpod_schemas.poses import make_pose
from rpod_schemas.sensors import sensor_kind
from rpod_target import Target
from rpod_target.equivalence import Equivalence, Symmetry
from rpod_target.symmetry import TURNS, FoundSymmetry, Likeness, find_symmetries

_VIEWS = 12
"""Number of poses of each sensor, a third at each of its ranges."""
_SEED = 2
_MODEL_ERROR = 1e-3
"""Range differences below this, over the longest side, count as errors of the model: the largest error of a
simplified mesh."""
_SURE = float(np.log(19.0))
"""Log likelihood by which a pose wins that the acquisitions accept: a weight of 0.95."""
_MOST_SIGMAS = 3.0
"""Greatest difference of a ray that counts, in standard deviations, so that no single stray ray decides."""
_SAME_BRIGHTNESS = 1
"""Steps between dark, grey and white that a camera's light and exposure may hide."""
_BRIGHTNESS = {"dark": 0, "grey": 1, "white": 2, "mirror": 4}
_FEWEST, _FEWEST_PIXELS = 6, 200
"""Least number of a scan's rays, and of an image's pixels, by which two poses are aligned and compared."""
_HELD = 1e-6
"""Share of the information's trace that is added: directions that no ray determines then do not move."""
_SAME_ATTITUDE = float(np.cos(np.deg2rad(1.0)))
"""Cosine of the angle below which two attitudes are one; axes are found to a fraction of a degree."""
_REACH = 2
"""Reach of the comparison, rays: a ray beside a jump, and its neighbour."""
_STEEPEST = 0.2
"""Least cosine of incidence of a ray whose range is compared; at steeper ones the footprint decides it."""


def checked_symmetries(target: Target) -> list[FoundSymmetry]:
    """Return a target's exact symmetries, then its near ones, each with how well the sensors resolve it.

    A symmetry is exact if no sensor distinguishes it in any view. A small part, which the comparison by shape
    meets in few places, may distinguish it.
    """
    found = find_symmetries(target)
    if not found:
        return []
    sensors = [_lidar(target), _pmd(target)]
    checked = []
    for one in found:
        likeness = tuple(each for sensor in sensors for each in _likeness(target, sensor, one))
        exact = all(each.alike == each.views for each in likeness) if likeness else one.exact
        mistaken = exact or any(_is_mistaken(one, each) for each in likeness)
        checked.append(replace(one, exact=exact, likeness=likeness, mistaken=mistaken))
    checked = _consistent(checked)
    covered = [one for one in checked if one.continuous and one.mistaken]
    kept = _generating([one for one in checked if not any(_includes(other, one) for other in covered)])
    return sorted(kept, key=lambda one: (not one.exact, not one.mistaken))


def _generating(found: list[FoundSymmetry]) -> list[FoundSymmetry]:
    """Return two axes of a ball, whose turns are together all turns; of another body all its symmetries."""
    free = [one for one in found if one.exact and one.continuous]
    for other in free[1:]:
        if abs(np.dot(other.axis, free[0].axis)) < _SAME_ATTITUDE:
            return [free[0], other]
    return found


def _is_mistaken(one: FoundSymmetry, seen: Likeness) -> bool:
    """Return whether a sensor cannot distinguish the poses in half of the views, of any turn in any view.

    Where a few parts alone tell any turn, the sides that do not show them leave the angle open.
    """
    return seen.alike > 0 if one.continuous else 2 * seen.alike >= seen.views


def _consistent(checked: list[FoundSymmetry]) -> list[FoundSymmetry]:
    """Return symmetries of which the exact ones together generate no turn that a sensor distinguishes.

    Each of two half turns may stay just below what the views distinguish, and their product above. The exact
    one that is distinguished best is then a near one. Near symmetries of any turn are not compared: a polygon
    of many sides counts as round, though any turn is only near.
    """
    while True:
        exact = [one for one in checked if one.exact]
        group = Equivalence.of(
            [Symmetry(one.axis, one.order, exact=True, continuous=one.continuous) for one in exact]
        )
        near = [one for one in checked if not one.exact and not one.continuous]
        turns = [
            Rotation.from_rotvec(2.0 * np.pi / one.order * np.array(one.axis)).as_matrix() for one in near
        ]
        generated = [group.cosines(turn[None], np.eye(3)[None])[0, 0] for turn in turns]
        if not exact or max(generated, default=-1.0) < _SAME_ATTITUDE:
            return checked
        worst = max(exact, key=_best_distinguished)
        checked = [replace(one, exact=False) if one is worst else one for one in checked]


def _best_distinguished(one: FoundSymmetry) -> float:
    return max((each.log_likelihood for each in one.likeness), default=0.0)


def _includes(around: FoundSymmetry, one: FoundSymmetry) -> bool:
    """Return whether a continuous symmetry includes another symmetry about the same axis."""
    return one.axis == around.axis and not one.continuous and one.exact <= around.exact


@dataclass(frozen=True, eq=False)
class _View:
    """Measurements of one emulated frame of a sensor."""

    condition: Condition
    look: "_Look"
    """Surfaces that its rays meet."""
    measured: int
    """Number of rays with a range."""
    sigma_m: float
    """Standard deviation of the range, of one ray alone."""
    systematic_m: float
    """Standard deviation of the errors that the next frame has too, so that no average removes them."""


@dataclass(frozen=True, eq=False)
class _Sensor:
    name: str
    grid: RayGrid
    views: tuple[_View, ...]
    """Views in which the target is measured."""
    sees_brightness: bool


def _lidar(target: Target) -> _Sensor:
    config = LidarConfig()
    grid = RayGrid.azimuth_elevation(config.azimuth_rad, config.elevation_rad)
    views = []
    for number, condition, emulated in _conditions("lidar", target):
        frame = emulated.frame(condition.T_sensor_target, sun_W_m2=condition.sun_W_m2, number=number)
        if frame is not None and len(frame.returns_m) >= _FEWEST:
            look = _Look.of(target, grid, condition.T_sensor_target)
            views.append(_View(condition, look, len(frame.returns_m), config.noise.sigma_range_m, 0.0))
    return _Sensor("lidar", grid, tuple(views), sees_brightness=False)


def _pmd(target: Target) -> _Sensor:
    grid, views = RayGrid.pinhole(PmdConfig().camera), []
    for number, condition, emulated in _conditions("pmd", target):
        depths_m = []
        for one in (2 * number, 2 * number + 1):
            frame = emulated.frame(condition.T_sensor_target, sun_W_m2=condition.sun_W_m2, number=one)
            if frame is not None:
                depths_m.append(frame.images[0].values)
        look = _Look.of(target, grid, condition.T_sensor_target)
        true_m = look.range_m * grid.components[2]
        both = np.isfinite([*depths_m, true_m]).all(axis=0) if len(depths_m) == 2 else np.zeros(0, bool)
        if both.sum() >= _FEWEST_PIXELS:
            first_m, second_m, at_m = (depth_m[both] for depth_m in (*depths_m, true_m))
            sigma_m = max(_spread(first_m - second_m) / np.sqrt(2.0), 1e-6)
            error_m = _spread(0.5 * (first_m + second_m) - at_m)
            systematic_m = float(np.sqrt(max(error_m**2 - 0.5 * sigma_m**2, 0.0)))
            views.append(_View(condition, look, int(both.sum()), sigma_m, systematic_m))
    return _Sensor("pmd", grid, tuple(views), sees_brightness=True)


def _spread(values: FloatArray) -> float:
    """Return the standard deviation of values about their median, by their median distance from it."""
    return MAD_TO_SIGMA * float(np.median(np.abs(values - np.median(values))))


def _conditions(kind: str, target: Target) -> Iterator[tuple[int, Condition, EmulatedKind]]:
    emulated = EmulatedKind(sensor_kind(kind), target, seed=_SEED)
    for number, condition in enumerate(conditions(emulated, target, _VIEWS, seed=_SEED), start=1):
        yield number, condition, emulated


def _likeness(target: Target, sensor: _Sensor, one: FoundSymmetry) -> list[Likeness]:
    """Return how well a sensor distinguishes the two poses, by condition.

    About a free axis, the turn that the sensor distinguishes best counts.
    """
    turns = TURNS if one.continuous else (1.0 / one.order,)
    rotations = [Rotation.from_rotvec(2.0 * np.pi * turn * np.array(one.axis)) for turn in turns]
    turned = [_turn(rotation, one) for rotation in rotations]
    seen: dict[str, list[tuple[float, float]]] = {}
    for view in sensor.views:
        pose = view.condition.T_sensor_target
        measured = min(view.measured / max(int(view.look.hit.sum()), 1), 1.0)
        won = measured * max(_log_likelihood(target, sensor, pose * turn, view) for turn in turned)
        seen.setdefault(view.condition.name, []).append((float(np.linalg.norm(pose.translation)), won))
    return [
        Likeness(
            sensor.name,
            name,
            float(np.median([range_m for range_m, _ in each])),
            len(each),
            sum(won < _SURE for _, won in each),
            float(np.median([won for _, won in each])),
        )
        for name, each in seen.items()
    ]


def _turn(rotation: Rotation, one: FoundSymmetry) -> RigidTransform:
    """Return the turn about the symmetry's axis, which may pass beside the origin."""
    beside_m = np.array(one.through_m)
    return make_pose(rotation=rotation, translation_m=beside_m - rotation.apply(beside_m))


@dataclass(frozen=True, eq=False)
class _Look:
    """Surfaces that the rays of a sensor meet."""

    range_m: FloatArray
    """Range of each ray, shape (rows, columns); inf without a hit."""
    normals: FloatArray
    """Normals, sensor axes, shape (rows, columns, 3)."""
    brightness: NDArray[np.int64]
    """Step of brightness of the surface, shape (rows, columns)."""

    @classmethod
    def of(cls, target: Target, grid: RayGrid, pose: RigidTransform) -> "_Look":
        hits = cast(grid, target.triangles_m, pose, cull_back_faces=True)
        triangle = np.maximum(hits.triangle, 0)
        steps = np.array([_BRIGHTNESS[material.looks] for material in target.materials])
        normals, brightness = pose.rotation.apply(target.normals), steps[target.triangle_material]
        return cls(hits.range_m.astype(np.float64), normals[triangle], brightness[triangle])

    def within(self, window: tuple[slice, slice]) -> "_Look":
        """Return what the rays of some rows and columns meet."""
        return _Look(self.range_m[window], self.normals[window], self.brightness[window])

    def rim(self, limit_m: float) -> NDArray[np.bool_]:
        """Return the rays beside which the range jumps, or bends, by more than a limit."""
        known_m = np.where(self.hit, self.range_m, 1e9)
        rim = np.zeros(known_m.shape, bool)
        rim[1:-1] |= np.abs(np.diff(known_m, n=2, axis=0)) > limit_m
        rim[:, 1:-1] |= np.abs(np.diff(known_m, n=2, axis=1)) > limit_m
        return rim

    @property
    def hit(self) -> NDArray[np.bool_]:
        """Rays that meet the target."""
        return np.isfinite(self.range_m)


def _log_likelihood(target: Target, sensor: _Sensor, turned: RigidTransform, view: _View) -> float:
    """Return the expected log likelihood by which the right pose wins over a turned one."""
    size_m = float(np.ptp(target.triangles_m, axis=(0, 1)).max())
    slack_m, sigma_m = _MODEL_ERROR * size_m + view.systematic_m, view.sigma_m
    right, first = view.look, _Look.of(target, sensor.grid, turned)
    aligned = _aligned(sensor, right, first, turned, limit_m=_MOST_SIGMAS * sigma_m + slack_m)
    tried = (first, _Look.of(target, sensor.grid, aligned))
    return min(_difference(sensor, right, other, sigma_m=sigma_m, slack_m=slack_m) for other in tried)


def _difference(sensor: _Sensor, right: _Look, other: _Look, *, sigma_m: float, slack_m: float) -> float:
    window = window_around(right.hit | other.hit, (_REACH, _REACH))
    right, other = right.within(window), other.within(window)
    both = right.hit & other.hit
    cosine = np.abs(np.einsum("rci,rci->rc", right.normals, sensor.grid.directions[window]))
    compared = both & (cosine > _STEEPEST)
    limit_m = slack_m + _MOST_SIGMAS * sigma_m
    rim = _near(right.rim(limit_m) | other.rim(limit_m))
    off_m = np.where(rim, *(_apart(right, other, reach=reach) for reach in (1, 0)))[compared]
    sigmas = np.clip((off_m - slack_m) / sigma_m, 0.0, _MOST_SIGMAS)
    lone = (right.hit & ~_near(other.hit)) | (other.hit & ~_near(right.hit))
    count = int(lone.sum())
    if sensor.sees_brightness:
        low, high = (filtered(other.brightness, size=3) for filtered in (minimum_filter, maximum_filter))
        apart = np.maximum(low - right.brightness, right.brightness - high)
        count += int((both & (apart > _SAME_BRIGHTNESS)).sum())
    return 0.5 * float((sigmas**2).sum()) + 0.5 * _MOST_SIGMAS**2 * count


def _apart(right: _Look, other: _Look, *, reach: int) -> FloatArray:
    """Return the least difference of each ray's range from those of the other within a reach of rays."""
    rows, columns = right.range_m.shape[:2]
    least_m = np.full((rows, columns), np.inf)
    around = np.pad(other.range_m, reach, constant_values=np.inf)
    ranges_m = np.where(right.hit, right.range_m, 0.0)
    for row in range(2 * reach + 1):
        for column in range(2 * reach + 1):
            there_m = around[row : row + rows, column : column + columns]
            np.minimum(least_m, np.abs(ranges_m - there_m), out=least_m)
    return least_m


def _near(hit: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the rays of which one in the neighbourhood meets the target."""
    grown: NDArray[np.bool_] = maximum_filter(hit, size=3)
    return grown


def _aligned(
    sensor: _Sensor, right: _Look, other: _Look, pose: RigidTransform, *, limit_m: float
) -> RigidTransform:
    """Return the pose after the least-squares step that brings its ranges to those of the right one.

    A point p on a plane with the normal n, moved by v + w x (p - t), changes its range along the ray u by
    n . (v + w x (p - t)) / (n . u).
    """
    used = right.hit & other.hit
    off_m = np.zeros_like(right.range_m)
    off_m[used] = right.range_m[used] - other.range_m[used]
    used &= np.abs(off_m) < limit_m
    rays, normals = sensor.grid.directions[used], other.normals[used]
    cosine = np.einsum("ij,ij->i", rays, normals)
    steep = np.abs(cosine) < _STEEPEST
    rays, normals, cosine, off_m = rays[~steep], normals[~steep], cosine[~steep], off_m[used][~steep]
    if len(off_m) < _FEWEST:
        return pose
    lever_m = other.range_m[used][~steep][:, None] * rays - pose.translation
    size_m = float(np.abs(lever_m).max())
    rows = np.hstack([normals, np.cross(lever_m / size_m, normals)])
    normal = rows.T @ rows
    step = np.linalg.solve(normal + _HELD * np.trace(normal) * np.eye(6), rows.T @ (off_m * cosine))
    return make_pose(
        rotation=Rotation.from_rotvec(step[3:] / size_m) * pose.rotation,
        translation_m=pose.translation + step[:3],
    )
