"""Aligns the rows of a turning head's scans where each row has its own azimuth offset (destaggering).

The lasers of a turning head point to different azimuths, so the returns of one firing, a column of the cloud,
have another azimuth in each row. Ouster's rows are offset by up to 4 deg, those of others by up to 6.
With a head that turns evenly, row r and column c look at the azimuth

    a(r, c) = s c + b(r)

with the step s of the columns. Each row's own returns give its b. A row is moved by whole columns, so that
neighbours in the scan are neighbours in the world. What is left, at most half a column, is the offset of the
row's azimuth from its columns. Cells that are empty after this were not measured. They are set to infinity,
which methods do not take for a missing return.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from rpod_schemas.types import Float32Array

_LEAST_STAGGER = 0.5
"""Least azimuth offset of a row, in columns, for a scan to be staggered: beyond it another ray is nearer."""
_FIT = 0.2
"""Greatest distance of most returns from the even pattern, in columns; else the columns are not even."""
_MOST = 0.9
"""Share of the returns that must be near the even pattern; the others are strays, or the head moved."""
_LEAST_ROWS, _LEAST_RETURNS = 3, 12
"""Least number of rows with returns, and of returns beside each other in rows, that show a pattern."""
_FEW = 3
"""Least number of returns in a row that show its offset."""
_NEAR = 4
"""Greatest number of columns between two returns whose azimuths give the step."""
_LEARNED = 10
"""Number of scans with returns in a row after which its azimuth is known: a head does not change."""
_FARTHEST_RAD = np.radians(15.0)
"""Greatest azimuth offset of a row. Lasers of turning heads are within 6 deg."""

Angles = NDArray[np.float64]


@dataclass
class StaggeredRows:
    """The azimuth offsets of one scanner's rows, as its scans show them."""

    rows: int
    """Number of rows of a scan."""
    columns: int
    """Number of columns of a scan as it is sent."""
    step_rad: float = 0.0
    """Step of the columns; 0 as long as the scans do not show that their rows are staggered."""
    _first_rad: float = 0.0
    _sums: NDArray[np.complex128] = field(init=False)
    _scans: NDArray[np.intp] = field(init=False)
    _shifts: NDArray[np.intp] = field(init=False)
    _margins: tuple[int, int] = (0, 0)

    def __post_init__(self) -> None:
        self._sums = np.zeros(self.rows, np.complex128)
        self._scans, self._shifts = np.zeros(self.rows, np.intp), np.zeros(self.rows, np.intp)

    @property
    def beside_rad(self) -> Angles | None:
        """Azimuth offset of each row after it was moved, shape (rows,); None if not staggered."""
        if not self.step_rad:
            return None
        beside = np.angle(self._sums * np.exp(-1j * self._first_rad)) - self._shifts * self.step_rad
        return np.where(self._scans > 0, beside, 0.0)

    @property
    def aside_rad(self) -> float:
        """Greatest azimuth offset of a row from the middle, as the rows were sent; 0 if not staggered."""
        return float(np.abs(self._shifts).max() * abs(self.step_rad))

    def learns(self, points_m: Float32Array) -> bool:
        """Return whether a scan, (rows, columns, 3), has returns in a row that is not known well yet."""
        few = points_m[self._scans < _LEARNED]
        return bool(few.size and (np.isfinite(few[..., 0]) & (few != 0.0).any(axis=-1)).any())

    def learn(self, azimuth: Angles, returned: NDArray[np.bool_]) -> None:
        """Learn from a scan, as it was sent.

        Args:
            azimuth: azimuths, rad, shape (rows, columns), one elevation a row.
            returned: which rays gave a return, shape (rows, columns).
        """
        new = (returned.sum(axis=1) >= _FEW) & (self._scans < _LEARNED)
        if not new.any():
            return
        found = _rows_of(azimuth, returned, self.step_rad)
        if found is None:
            return
        step_rad, rows_rad = found
        unknown = new & (self._scans == 0)
        self._sums[new] += np.exp(1j * rows_rad[new])
        self._scans += new
        if not self.step_rad:
            self._begin(step_rad)
        elif unknown.any():
            aside = np.angle(self._sums * np.exp(-1j * self._first_rad))
            self._shifts[unknown] = np.round(aside[unknown] / self.step_rad).astype(np.intp)

    def _begin(self, step_rad: float) -> None:
        """Move rows from now on if they are staggered."""
        known = self._scans > 0
        rows_rad = np.angle(self._sums)
        middle = np.angle(np.exp(1j * rows_rad[known]).sum())
        columns = np.angle(np.exp(1j * (rows_rad - middle))) / step_rad
        if np.ptp(columns[known]) < _LEAST_STAGGER:
            return
        if np.ptp(columns[known]) * abs(step_rad) > 2.0 * _FARTHEST_RAD:
            return
        # the zero for which the rows are as near to whole columns as possible
        part = np.angle(np.exp(2j * np.pi * columns[known]).sum()) / (2.0 * np.pi)
        self._first_rad, self.step_rad = middle + part * step_rad, step_rad
        self._shifts = np.where(known, np.round(columns - part), 0).astype(np.intp)
        if not self._turns_around:
            self._margins = max(0, -int(self._shifts.min())), max(0, int(self._shifts.max()))

    @property
    def _turns_around(self) -> bool:
        """Whether the columns are a whole turn."""
        return abs(self.columns * abs(self.step_rad) - 2.0 * np.pi) < abs(self.step_rad)

    def in_order(self, image: Float32Array) -> Float32Array:
        """Return an image of a scan, (rows, columns, ...), with its rows moved; itself if not staggered.

        Columns are added at both sides unless they are a whole turn. Points that no ray measured are
        infinite, other values NaN.
        """
        if not self.step_rad:
            return image
        before, behind = self._margins
        source = np.arange(-before, self.columns + behind) - self._shifts[:, None]
        if self._turns_around:
            source %= self.columns
        inside = (source >= 0) & (source < self.columns)
        rows = np.arange(self._shifts.size)[:, None]
        moved: Float32Array = image[rows, source.clip(0, self.columns - 1)]
        moved[~inside] = np.inf if image.ndim > 2 else np.nan
        return moved


def _rows_of(azimuth: Angles, returned: NDArray[np.bool_], step_rad: float) -> tuple[float, Angles] | None:
    """Return the step of the columns and each row's azimuth at column 0; None if the columns are not even.

    Args:
        azimuth: azimuths, rad, shape (rows, columns).
        returned: which of them are returns.
        step_rad: the step if it is known, else 0.
    """
    row, column = np.nonzero(returned)
    angles = azimuth[row, column]
    if not step_rad:
        if returned.any(axis=1).sum() < _LEAST_ROWS:
            return None
        step_rad = _step_of(row, column, angles, azimuth.shape[1])
        if not step_rad:
            return None
    rows_rad = _first_of(row, angles - step_rad * column, len(azimuth))
    off = np.abs(np.angle(np.exp(1j * (angles - step_rad * column - rows_rad[row]))))
    return (step_rad, rows_rad) if np.quantile(off, _MOST) <= _FIT * abs(step_rad) else None


def _step_of(row: NDArray[np.intp], column: NDArray[np.intp], angles: Angles, columns: int) -> float:
    """Return the step of the columns, 0 if it is not known, from returns, shape (N,), row by row."""
    gap = np.diff(column)
    beside = (np.diff(row) == 0) & (gap <= _NEAR)
    if np.count_nonzero(beside) < _LEAST_RETURNS:
        return 0.0
    step = float(np.median(np.angle(np.exp(1j * np.diff(angles)[beside])) / gap[beside]))
    if abs(columns * abs(step) - 2.0 * np.pi) < 0.05 * 2.0 * np.pi:  # a whole turn
        return float(np.copysign(2.0 * np.pi / columns, step))
    for _ in range(2):  # the slope over whole rows is far more accurate than that of neighbours
        first = _first_of(row, angles - step * column, int(row.max()) + 1)
        off = np.angle(np.exp(1j * (angles - step * column - first[row])))
        number = np.maximum(np.bincount(row), 1)
        from_middle = column - (np.bincount(row, column) / number)[row]
        if not from_middle.any():
            return 0.0
        step += float(from_middle @ off / (from_middle @ from_middle))
    return step


def _first_of(row: NDArray[np.intp], angles: Angles, rows: int) -> Angles:
    """Return the median of the angles in each row, rad, shape (rows,), 0 without any; wrapped angles."""
    mean = np.arctan2(np.bincount(row, np.sin(angles), rows), np.bincount(row, np.cos(angles), rows))
    off = np.angle(np.exp(1j * (angles - mean[row])))
    order = np.lexsort((off, row))
    number = np.bincount(row, minlength=rows)
    middle = np.cumsum(number) - number + number // 2
    median = np.zeros(rows)
    median[number > 0] = off[order][middle[number > 0]]
    first: Angles = np.where(number > 0, mean + median, 0.0)
    return first
