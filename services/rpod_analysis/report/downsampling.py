"""Downsampling of the data that are drawn, for runs of any length."""

import numpy as np
from numpy.typing import NDArray

from rpod_analysis.scoring.score import BoolArray, IntArray
from rpod_schemas.arrays import FloatArray

MOST_POINTS = 5000
"""Largest number of points of a line."""
MOST_STRETCHES = 2000
"""Largest number of intervals of a band."""


class Bins:
    """The time span of a run, divided into equal parts."""

    def __init__(self, span_ns: tuple[int, int], parts: int) -> None:
        self._start_ns = span_ns[0]
        self._width_ns = max((span_ns[1] - span_ns[0]) / parts, 1.0)

    def of(self, stamp_ns: IntArray) -> IntArray:
        """Return the part in which each stamp lies."""
        return ((stamp_ns - self._start_ns) // self._width_ns).astype(np.int64)


class Line:
    """A line of at most about 5,000 points: the lowest and highest of each part, so that no peak is lost."""

    def __init__(self, span_ns: tuple[int, int], most: int = MOST_POINTS) -> None:
        self._bins = Bins(span_ns, most // 2)
        self._most = most
        self.stamp_ns: IntArray = np.empty(0, np.int64)
        self.values: FloatArray = np.empty(0)

    def extend(self, stamp_ns: IntArray, values: FloatArray) -> None:
        """Add points; NaN is left out."""
        known: BoolArray = np.isfinite(values)
        keep = self._extremes(stamp_ns[known], values[known])
        self.stamp_ns = np.concatenate([self.stamp_ns, stamp_ns[known][keep]])
        self.values = np.concatenate([self.values, values[known][keep]])
        if self.stamp_ns.size > self._most:
            keep = self._extremes(self.stamp_ns, self.values)
            self.stamp_ns, self.values = self.stamp_ns[keep], self.values[keep]

    def _extremes(self, stamp_ns: IntArray, values: FloatArray) -> IntArray:
        bins = self._bins.of(stamp_ns)
        order = np.lexsort((values, bins))
        edges = np.flatnonzero(np.diff(bins[order], prepend=-1, append=-1))
        keep = np.concatenate([order[edges[:-1]], order[edges[1:] - 1]])
        return np.unique(keep)


class Samples:
    """Rows spread evenly over the time, the first of each part; about ``most`` at most."""

    def __init__(self, span_ns: tuple[int, int], most: int, columns: int = 0) -> None:
        self._bins = Bins(span_ns, most)
        self._last = -1
        self.stamp_ns: IntArray = np.empty(0, np.int64)
        self.rows: FloatArray = np.empty((0, columns))

    def extend(self, stamp_ns: IntArray, rows: FloatArray) -> IntArray:
        """Add rows that are later than those before; return which were kept."""
        bins, first = np.unique(self._bins.of(stamp_ns), return_index=True)
        keep: IntArray = first[bins > self._last]
        self._last = int(bins.max(initial=self._last))
        self.stamp_ns = np.concatenate([self.stamp_ns, stamp_ns[keep]])
        self.rows = np.concatenate([self.rows, rows[keep]])
        return keep


class Band:
    """Intervals of equal value over time; if there are too many, the shortest join those before them."""

    def __init__(self) -> None:
        self.start_ns: IntArray = np.empty(0, np.int64)
        self.values: NDArray[np.int64] = np.empty(0, np.int64)
        self.end_ns = 0
        self.left_out_ns = 0
        """Length below which intervals are not drawn, ns."""

    def extend(self, stamp_ns: IntArray, values: IntArray) -> None:
        """Add values that are later than those before; each is valid until the next."""
        if not stamp_ns.size:
            return
        self.start_ns = np.concatenate([self.start_ns, stamp_ns])
        self.values = np.concatenate([self.values, values])
        self.end_ns = int(stamp_ns[-1])
        self._join()
        if self.start_ns.size > 2 * MOST_STRETCHES:
            self._shorten()

    def _join(self) -> None:
        changes = np.flatnonzero(np.diff(self.values, prepend=-1))
        self.start_ns, self.values = self.start_ns[changes], self.values[changes]

    def _shorten(self) -> None:
        lengths_ns = np.diff(self.start_ns, append=self.end_ns)
        lengths_ns[[0, -1]] = np.iinfo(np.int64).max
        keep = np.sort(np.argsort(lengths_ns, kind="stable")[-MOST_STRETCHES:])
        shortest_ns = int(np.delete(lengths_ns, keep).max())
        self.left_out_ns = max(self.left_out_ns, shortest_ns)
        self.start_ns, self.values = self.start_ns[keep], self.values[keep]
        self._join()
