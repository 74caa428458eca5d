"""The directions of a scanner's rays, inferred from its points where the sensor does not state them.

A method needs the rays without a return as well as the returns. The points of an organised scan tell the
azimuth or elevation of each row and column that has returns; the other lines follow from these, since
scanners have nearly even steps. An unorganised scan has only returns. Where their azimuths or elevations
gather in lines, these are the lines of the pattern. Where only azimuths or only elevations gather, the points
within a line tell the step of the other angle. Otherwise, as in a scan that never repeats, the pattern has
even lines, whose step is the width of the empty circles between the points. An inferred pattern is extended
on both sides by as many lines as it has.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError
from scipy.spatial import Delaunay, KDTree, QhullError

from rpod_runtime.sensor_data.staggered_rows import StaggeredRows
from rpod_schemas.types import Float32Array, LidarInfo

Angles = NDArray[np.float64]
_AHEAD_RAD = np.radians(80.0)
_LEAST_LINES = 3
"""Least number of rows and of columns with returns from which a pattern is inferred."""
_DECISIVE = 0.5
"""Greatest ratio of the scatter within lines to that with rows and columns exchanged for which it is clear
which of the two are the lines."""
_LEVEL = 0.1
"""Greatest scatter of the elevations within the lines of lasers, over that of all elevations."""
_EVEN = 0.2
"""Greatest deviation of lines from even steps, over a step, of a pattern that counts as even."""
_ENOUGH_SCANS = 20
"""Number of scans with returns in a line after which further ones tell nothing new of it."""
_CHANGED = 0.2
"""Change of a line, over a step, from which on an inferred pattern is replaced."""
_GATHERED = 4.0
"""Least ratio of the steps between lines to those within a line."""
_NARROW = 0.06
"""Greatest RMS width of lines, over the step between them. Found numerically: the lines that random points
seem to form are wider in each of 300 random draws of 6 to 3,000 points."""
_STRAY = 0.25
"""Least number of points of a line over the usual one; fewer are strays between lines."""
_MARGIN = 8
"""Least number of lines added on both sides of the points of an unorganised scan."""
_MOST_LINES, _MOST_RAYS = 1024, 2**18
"""Greatest number of lines that are inferred from points, and of rays of the whole pattern."""
_OUTSIDE = 0.05
"""Share of an unorganised scan's points outside its pattern from which on it is inferred anew."""
_MIDDLE = 5_000
"""Number of points, around the middle of a scan, that tell how wide the empty circles are."""
_NEIGHBOURS = 400
"""Number of points whose distance to their neighbour is measured."""


def angles_of(points_m: Float32Array) -> tuple[Angles, Angles, NDArray[np.bool_]]:
    """Return azimuths and elevations of points, shape (..., 3), and which are returns, each shape (...)."""
    x, y, z = np.moveaxis(points_m.astype(np.float64), -1, 0)
    range_m = np.sqrt(x * x + y * y + z * z)
    returned = np.isfinite(range_m) & (range_m > 0.0)
    safe_m = np.where(returned, range_m, 1.0)
    azimuth = np.where(returned, np.arctan2(x, z), 0.0)
    elevation = np.where(returned, np.arcsin(np.clip(y / safe_m, -1.0, 1.0)), 0.0)
    return azimuth, elevation, returned


def is_ahead(azimuth_rad: Angles) -> NDArray[np.bool_]:
    """Return which azimuths, any shape, are within 80 deg of the boresight: methods see what lies ahead."""
    near: NDArray[np.bool_] = np.abs(np.angle(np.exp(1j * azimuth_rad))) <= _AHEAD_RAD
    return near


def columns_ahead(azimuth_rad: Angles) -> NDArray[np.intp]:
    """Return which columns of a pattern are ahead, in an order in which neighbours are next to each other.

    A head that turns all around may begin a scan anywhere, also straight ahead.

    Args:
        azimuth_rad: azimuths of the columns, of any turn, shape (columns,).
    """
    kept = np.flatnonzero(is_ahead(azimuth_rad))
    wrapped_rad = _wrapped(azimuth_rad[kept])
    steps_rad = np.diff(wrapped_rad)
    even = (steps_rad > 0.0).all() or (steps_rad < 0.0).all()
    return kept if even else kept[np.argsort(wrapped_rad, kind="stable")]


def ahead(pattern: LidarInfo) -> LidarInfo:
    """Return the part of a pattern that is ahead, within half a turn; the pattern itself if all of it is."""
    azimuth_rad = _wrapped(pattern.azimuth_rad[columns_ahead(pattern.azimuth_rad)])
    whole = np.array_equal(azimuth_rad, pattern.azimuth_rad)
    return pattern if whole else pattern.model_copy(update={"azimuth_rad": azimuth_rad})


def _wrapped(azimuth_rad: Angles) -> Angles:
    wrapped_rad: Angles = np.where(
        np.abs(azimuth_rad) <= np.pi, azimuth_rad, np.angle(np.exp(1j * azimuth_rad))
    )
    return wrapped_rad


def rows_are_elevation(points_m: Float32Array) -> bool | None:
    """Return whether the rows of an organised scan have one elevation each; None if the points do not tell.

    Args:
        points_m: shape (rows, columns, 3), sensor axes.
    """
    azimuth, elevation, returned = angles_of(points_m)
    if min(returned.any(axis=1).sum(), returned.any(axis=0).sum()) < _LEAST_LINES:
        return None
    # each laser of a turning head has one elevation, also where their azimuths are staggered
    limit = _LEVEL * _scatter(elevation.reshape(1, -1), returned.reshape(1, -1), 1)
    level = [_scatter(elevation, _with_neighbours(returned, axis), axis) < limit for axis in (1, 0)]
    if level[0] != level[1]:
        return level[0]
    upright = _scatter(elevation, returned, 1) + _scatter(azimuth, returned, 0)
    turned = _scatter(azimuth, returned, 1) + _scatter(elevation, returned, 0)
    if upright < _DECISIVE * turned:
        return True
    return False if turned < _DECISIVE * upright else None


def _with_neighbours(returned: NDArray[np.bool_], axis: int) -> NDArray[np.bool_]:
    """Return which returns have others in their line: a single one tells nothing about the line."""
    several: NDArray[np.bool_] = returned & (returned.sum(axis=axis, keepdims=True) > 1)
    return several


def _scatter(angles: Angles, returned: NDArray[np.bool_], axis: int) -> float:
    """Return the median distance of returns from the mean direction of their line, rad; inf without any."""
    if not returned.any():
        return float("inf")
    means = np.angle((np.exp(1j * angles) * returned).sum(axis=axis, keepdims=True))
    off = np.abs(np.angle(np.exp(1j * (angles - means))))
    return float(np.median(off[returned]))


@dataclass
class GridInference:
    """Infers the pattern of one scanner from its scans."""

    pattern: LidarInfo | None = None
    """The pattern as far as it is known; replaced only where it has changed visibly."""
    _staggered: StaggeredRows | None = None
    _sums: dict[str, NDArray[np.complex128]] = field(default_factory=dict)
    _scans: NDArray[np.intp] = field(default_factory=lambda: np.zeros(0, np.intp))
    """Number of scans with returns in each row and each column."""

    def in_order(self, image: Float32Array) -> Float32Array:
        """Return an image of a scan as it was sent, shape (rows, columns, ...), with its rows in order."""
        staggered = self._staggered
        if staggered is None or image.shape[:2] != (staggered.rows, staggered.columns):
            return image
        return staggered.in_order(image)

    def learn_rows(self, points_m: Float32Array) -> None:
        """Learn the azimuth offsets of the rows from an organised scan as it was sent, (rows, columns, 3)."""
        rows, columns = points_m.shape[:2]
        if self._staggered is None or (self._staggered.rows, self._staggered.columns) != (rows, columns):
            self._staggered = StaggeredRows(rows, columns)
        if self._staggered.learns(points_m):
            azimuth, _, returned = angles_of(points_m)
            self._staggered.learn(azimuth, returned)

    @property
    def aside_rad(self) -> float:
        """Greatest azimuth offset of a row from the columns, rad; 0 if the rows are not staggered."""
        return 0.0 if self._staggered is None else self._staggered.aside_rad

    @property
    def _beside_rad(self) -> Angles | None:
        return None if self._staggered is None else self._staggered.beside_rad

    def add(self, points_m: Float32Array, scan_time_s: float) -> None:
        """Learn from a scan.

        Args:
            points_m: points, sensor axes; (rows, columns, 3) with one elevation a row, else (N, 3).
            scan_time_s: duration of the scan, 0 if it is unknown.
        """
        if points_m.ndim == 3 and self._shows_known_lines(points_m):
            return
        azimuth, elevation, returned = angles_of(points_m)
        beside_rad = self._beside_rad if points_m.ndim == 3 else None
        if points_m.ndim == 3:
            if beside_rad is not None:
                azimuth = azimuth - beside_rad[:, None]
            columns = self._organised("azimuth", azimuth, returned, 0)
            rows = self._organised("elevation", elevation, returned, 1)
        else:
            # a head that turns all around in a room sees walls all around
            seen = returned & is_ahead(azimuth)
            azimuth, elevation = azimuth[seen], elevation[seen]
            if self.pattern is not None and _covers(self.pattern, azimuth, elevation):
                return
            columns, rows = _widened(*_unorganised(azimuth, elevation))
        if columns is None or rows is None:
            return
        try:
            now = LidarInfo(
                azimuth_rad=columns,
                elevation_rad=rows,
                row_azimuth_rad=beside_rad,
                scan_time_s=scan_time_s,
                sigma_range_m=0.0,
            )
        except ValidationError:
            return  # points of no scanner
        if self.pattern is None or _differ(self.pattern, now):
            self.pattern = now

    def _shows_known_lines(self, points_m: Float32Array) -> bool:
        """Return whether enough scans have had returns in all lines in which this one has any."""
        returned = np.isfinite(points_m[..., 0]) & (points_m != 0.0).any(axis=-1)
        seen = np.concatenate((returned.any(axis=1), returned.any(axis=0)))
        if self._scans.shape != seen.shape:
            self._scans = np.zeros(seen.shape, np.intp)
        self._scans += seen
        return self.pattern is not None and bool((self._scans[seen] > _ENOUGH_SCANS).all())

    def _organised(self, name: str, angles: Angles, returned: NDArray[np.bool_], axis: int) -> Angles | None:
        """Return the angles of all lines, from the returns of all scans; None as long as they are too few."""
        sums = (np.exp(1j * angles) * returned).sum(axis=axis)
        before = self._sums.get(name)
        if before is None or before.shape != sums.shape:
            before = np.zeros_like(sums)
        self._sums[name] = sums = before + sums
        known = np.flatnonzero(np.abs(sums) > 0.0)
        if known.size < _LEAST_LINES:
            return None
        return _all_lines(known, np.angle(sums[known]), sums.size)


def _covers(pattern: LidarInfo, azimuth: Angles, elevation: Angles) -> bool:
    """Return whether all but a few points, shape (N,) each, are within a pattern."""
    outside = np.zeros(azimuth.shape, bool)
    for lines, angles in ((pattern.azimuth_rad, azimuth), (pattern.elevation_rad, elevation)):
        outside |= (angles < lines.min()) | (angles > lines.max())
    return bool(np.count_nonzero(outside) <= _OUTSIDE * outside.size)


def _differ(before: LidarInfo, now: LidarInfo) -> bool:
    """Return whether two patterns differ visibly."""
    lines = ((before.azimuth_rad, now.azimuth_rad), (before.elevation_rad, now.elevation_rad))
    old, new = before.row_azimuth_rad, now.row_azimuth_rad
    if (old is None) != (new is None):
        return True
    if old is not None and new is not None:
        step = np.median(np.abs(np.diff(before.azimuth_rad)))
        if old.shape != new.shape or np.abs(new - old).max() > _CHANGED * step:
            return True
    return any(
        old.shape != new.shape or np.abs(new - old).max() > _CHANGED * np.median(np.abs(np.diff(old)))
        for old, new in lines
    )


def _all_lines(known: NDArray[np.intp], angles: Angles, count: int) -> Angles | None:
    """Return the angles of ``count`` lines, of which some are known; None if they are not in order."""
    turns = 2.0 * np.pi
    apart = np.diff(known)
    step = float(np.median((np.diff(angles) + np.pi) % turns - np.pi) / np.median(apart))
    jumps = np.diff(angles)
    jumps -= turns * np.round((jumps - step * apart) / turns)
    angles = angles[0] + np.append(0.0, np.cumsum(jumps))
    steps = jumps / apart
    step = float(np.median(steps))
    if step == 0.0 or (np.sign(steps) != np.sign(step)).any():
        return None
    slope, first = np.polyfit(known, angles, 1)
    index = np.arange(count)
    if np.abs(first + slope * known - angles).max() <= _EVEN * abs(slope):
        lines = first + slope * index
    else:
        lines = np.interp(index, known, angles)
        lines += np.where(index < known[0], index - known[0], 0) * step
        lines += np.where(index > known[-1], index - known[-1], 0) * step
    centred: Angles = lines - turns * np.round(lines.mean() / turns)
    return centred


def _places(azimuth: Angles, elevation: Angles) -> Angles:
    """Return the distinct places of points, shape (N, 2), rad."""
    return np.unique(np.stack((azimuth * np.cos(elevation), elevation), axis=1).round(6), axis=0)


def _apart_rad(azimuth: Angles, elevation: Angles) -> float:
    """Return the median angle from a point to its nearest neighbour; 0 of fewer than two places."""
    places = _places(azimuth, elevation)
    if len(places) < 2:
        return 0.0
    few = places[:: len(places) // _NEIGHBOURS + 1]
    apart, _ = KDTree(places).query(few, k=2)
    return float(np.median(np.asarray(apart)[:, 1]))


def _unorganised(azimuth: Angles, elevation: Angles) -> tuple[Angles | None, Angles | None]:
    """Return the columns and rows of an unorganised scan; None if its points, shape (N,), tell none."""
    apart_rad = _apart_rad(azimuth, elevation)
    if azimuth.size < _LEAST_LINES or not apart_rad:
        return None, None
    if max(np.ptp(azimuth), np.ptp(elevation)) > _MOST_LINES * apart_rad:
        return None, None
    columns, rows = _gathered(azimuth, apart_rad), _gathered(elevation, apart_rad)
    if columns is None and rows is None:
        step_rad = _empty_rad(azimuth, elevation)
        return _even(azimuth, step_rad), _even(elevation, step_rad)
    if columns is None:
        columns = _even(azimuth, _within_rad(azimuth, elevation, rows))
    if rows is None:
        rows = _even(elevation, _within_rad(elevation, azimuth, columns))
    return columns, rows


def _gathered(angles: Angles, apart_rad: float) -> Angles | None:
    """Return the lines in which angles gather; None if they do not."""
    ordered = np.sort(angles)
    steps = np.diff(ordered)
    between = steps > apart_rad / _GATHERED
    groups = np.split(ordered, np.flatnonzero(between) + 1)
    usual = float(np.median([group.size for group in groups]))
    groups = [group for group in groups if group.size >= _STRAY * usual]
    means = np.array([group.mean() for group in groups])
    if len(groups) < _LEAST_LINES or 2 * len(groups) >= angles.size:
        return None
    within = np.concatenate(groups) - np.repeat(means, [group.size for group in groups])
    if np.sqrt(np.mean(within**2)) > _NARROW * np.median(np.diff(means)):
        return None
    index = np.round((means - means[0]) / np.median(np.diff(means))).astype(np.intp)
    index, first = np.unique(index, return_index=True)
    lines = _all_lines(index, means[first], int(index[-1]) + 1)
    return None if lines is None or not 2 <= lines.size <= _MOST_LINES else lines


def _within_rad(angles: Angles, others: Angles, lines: Angles | None) -> float:
    """Return the median step between neighbours in one line, rad; ``others`` are the angles of the lines."""
    assert lines is not None  # noqa: S101 - of two axes one has lines
    line = np.abs(others[:, None] - lines).argmin(axis=1)
    order = np.lexsort((angles, line))
    steps = np.diff(angles[order])[np.diff(line[order]) == 0]
    steps = steps[steps > 0.0]
    return float(np.median(steps)) if steps.size else 0.0


def _empty_rad(azimuth: Angles, elevation: Angles) -> float:
    """Return the usual radius of the empty circles between points, rad; 0 of points on a line.

    These are the circles around the triangles of Delaunay's triangulation. Half of the area has greater ones.
    """
    places = _places(azimuth, elevation)
    middle = np.median(places, axis=0)
    places = places[np.argsort(((places - middle) ** 2).sum(axis=1))[:_MIDDLE]]
    try:
        corners = places[Delaunay(places - middle).simplices]
    except (QhullError, ValueError):
        return 0.0
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    (ax, ay), (bx, by) = np.moveaxis(corners[:, 1:] - corners[:, :1], 0, -1)
    area = 0.5 * np.abs(ax * by - ay * bx)
    radius = sides.prod(axis=1) / np.maximum(4.0 * area, 1e-30)
    order = np.argsort(radius)
    share = np.cumsum(area[order])
    return float(radius[order][np.searchsorted(share, share[-1] / 2.0)])


def _even(angles: Angles, step_rad: float) -> Angles | None:
    """Return even lines over angles; None if they are too few or too many."""
    if not step_rad or np.ptp(angles) > _MOST_LINES * step_rad:
        return None
    lines = np.arange(angles.min(), angles.max() + step_rad, step_rad)
    return lines if 2 <= lines.size <= _MOST_LINES else None


def _widened(columns: Angles | None, rows: Angles | None) -> tuple[Angles | None, Angles | None]:
    """Return the lines, extended on both sides by as many, or by a few, or by none if these are too many."""
    if columns is None or rows is None:
        return None, None
    for most in (_MOST_LINES, _MARGIN):
        wide = _with_margin(columns, most, np.pi), _with_margin(rows, most, np.pi / 2.0)
        if wide[0].size * wide[1].size <= _MOST_RAYS:
            return wide
    return None, None


def _with_margin(lines: Angles, most: int, most_rad: float) -> Angles:
    step = float(np.median(np.diff(lines)))
    beyond = np.arange(1, min(max(_MARGIN, lines.size), most) + 1) * step
    wide: Angles = np.concatenate((lines[0] - beyond[::-1], lines, lines[-1] + beyond))
    kept: Angles = wide[np.abs(wide) <= most_rad]
    return kept
