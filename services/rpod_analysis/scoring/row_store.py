"""Storage for the rows and numbers of a run of any length: first in memory, then on disk.

The memory is bounded by the size of a minute of the run. The statistics are exact.
"""

import pickle
from collections import OrderedDict, defaultdict
from collections.abc import Iterator
from tempfile import SpooledTemporaryFile, TemporaryFile
from typing import IO, Any
from weakref import finalize

import numpy as np
from numpy.typing import NDArray

from rpod_schemas.arrays import FloatArray
from rpod_schemas.rmw.cdr import NANOSECONDS

BLOCK_NS = 60 * NANOSECONDS
"""Length of a block of rows, ns: a minute."""
Row = tuple[Any, ...]
"""A row, whose first item is the stamp, ns."""

_MOST_PENDING = 20_000
_RECENT = 3
_IN_MEMORY_BYTES = 1 << 18
_BINS = 4096
_GATHERED = 1 << 15


class RowStore:
    """Rows that are added in any order and read by the minute of their stamps."""

    def __init__(self) -> None:
        self._file: IO[bytes] = TemporaryFile()  # noqa: SIM115
        finalize(self, self._file.close)
        self._pending: dict[int, list[Row]] = defaultdict(list)
        self._pending_rows = 0
        self._places: dict[int, list[int]] = defaultdict(list)
        self._recent: OrderedDict[int, list[Row]] = OrderedDict()
        self.count = 0
        self.first_ns: int | None = None
        """Lowest stamp."""
        self.last_ns: int | None = None
        """Highest stamp."""

    def add(self, row: Row) -> None:
        """Add a row."""
        stamp_ns = row[0]
        self._pending[stamp_ns // BLOCK_NS].append(row)
        self._recent.pop(stamp_ns // BLOCK_NS, None)
        self._pending_rows += 1
        self.count += 1
        self.first_ns = stamp_ns if self.first_ns is None else min(self.first_ns, stamp_ns)
        self.last_ns = stamp_ns if self.last_ns is None else max(self.last_ns, stamp_ns)
        if self._pending_rows >= _MOST_PENDING:
            self._write()

    def _write(self) -> None:
        self._file.seek(0, 2)
        for minute, rows in self._pending.items():
            self._places[minute].append(self._file.tell())
            pickle.dump(rows, self._file, pickle.HIGHEST_PROTOCOL)
        self._pending.clear()
        self._recent.clear()
        self._pending_rows = 0

    @property
    def minutes(self) -> list[int]:
        """Minutes that have rows, in the order of time."""
        return sorted({*self._places, *self._pending})

    def rows(self, minute: int) -> list[Row]:
        """Return a minute's rows in the order of their stamps; for equal stamps in the order of addition."""
        if minute not in self._recent:
            self._recent[minute] = sorted(self._read(minute), key=lambda row: row[0])
            if len(self._recent) > _RECENT:
                self._recent.popitem(last=False)
        return self._recent[minute]

    def _read(self, minute: int) -> Iterator[Row]:
        for place in self._places.get(minute, ()):
            self._file.seek(place)
            yield from pickle.load(self._file)  # noqa: S301 - our own file, which has no name
        yield from self._pending.get(minute, ())


class Column:
    """A column of any number of finite values, with exact statistics; NaN is left out."""

    def __init__(self, values: FloatArray | None = None) -> None:
        self._file: IO[bytes] = SpooledTemporaryFile(max_size=_IN_MEMORY_BYTES)  # noqa: SIM115
        finalize(self, self._file.close)
        self._sum = self._squares = 0.0
        self._low, self.max = np.inf, -np.inf
        self.count = 0
        if values is not None:
            self.extend(values)

    def __len__(self) -> int:
        return self.count

    def extend(self, values: FloatArray) -> None:
        """Add numbers."""
        finite = np.asarray(values, np.float64)[np.isfinite(values)]
        if not finite.size:
            return
        self._file.seek(0, 2)
        self._file.write(finite.tobytes())
        self._sum += float(finite.sum())
        self._squares += float((finite**2).sum())
        self._low = min(self._low, float(finite.min()))
        self.max = max(self.max, float(finite.max()))
        self.count += finite.size

    @property
    def mean(self) -> float:
        """Mean; there must be at least one number."""
        return self._sum / self.count

    @property
    def rms(self) -> float:
        """Root mean square; there must be at least one number."""
        return float(np.sqrt(self._squares / self.count))

    def share_up_to(self, bound: float) -> float:
        """Return the share of the numbers that are at or below a bound."""
        return sum(int((block <= bound).sum()) for block in self._blocks()) / self.count

    def quantile(self, share: float) -> float:
        """Return a quantile, interpolated linearly between neighbours, like ``numpy.quantile``."""
        position = share * (self.count - 1)
        below = self._of_rank(int(position))
        above = self._of_rank(min(int(position) + 1, self.count - 1))
        return below + (position - int(position)) * (above - below)

    def counts(self, edges: FloatArray) -> NDArray[np.int64]:
        """Return the number of values from each edge to below the next."""
        counts = np.zeros(len(edges) - 1, np.int64)
        for block in self._blocks():
            counts += np.diff(np.searchsorted(np.sort(block), edges))
        return counts

    def _of_rank(self, rank: int) -> float:
        """Return the value of a rank, from 0, by narrowing the range around it until it holds few values."""
        low, end = self._low, np.nextafter(self.max, np.inf)
        before, inside = 0, self.count
        while inside > _GATHERED:
            edges = np.unique(np.linspace(low, end, _BINS + 1))
            if edges.size == 2:
                return low  # no other number is between the ends
            counts = self.counts(edges)
            above = before + np.cumsum(counts)
            bin_ = int(np.searchsorted(above, rank, side="right"))
            low, end, inside = float(edges[bin_]), float(edges[bin_ + 1]), int(counts[bin_])
            before = int(above[bin_]) - inside
        found = np.concatenate([block[(low <= block) & (block < end)] for block in self._blocks()])
        return float(np.sort(found)[rank - before])

    def _blocks(self) -> Iterator[FloatArray]:
        self._file.seek(0)
        while data := self._file.read(_IN_MEMORY_BYTES):
            yield np.frombuffer(data, np.float64)
