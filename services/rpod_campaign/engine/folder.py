"""The folder of a campaign: its manifest, and the rows of every finished trial.

The folder's name contains a digest of all that determines a trial: parameters of the cells, seed, software.
The same campaign finds its folder again and continues where it stopped; any change makes another folder.
"""

import hashlib
import json
import os
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Self

import polars as pl

from rpod_campaign.engine.campaign import CELL, TRIAL, AnyCampaign, Row
from rpod_campaign.engine.errors import ForeignFolderError
from rpod_schemas.caches.whole_file import whole_file

MANIFEST = "manifest.json"
_ABANDONED_S = 600.0
"""Age above which an unfinished file counts as left over from a process that was killed, s."""
_MOST_PARTS = 256
"""Number of files of rows above which they are merged into one while the campaign runs."""
_READS = 5
"""Number of attempts to read while another run of the campaign may be merging files."""


@dataclass(frozen=True)
class CampaignFolder:
    """Folder in which the trials of one campaign are stored."""

    path: Path
    schema: Mapping[str, Any]
    """Columns of the rows, with cell and trial first."""
    keys: tuple[str, ...] = ()
    """Columns that distinguish the rows of one trial."""

    @classmethod
    def of(cls, campaign: AnyCampaign, path: Path) -> Self:
        """Return the folder of a campaign at a path; nothing is read or made."""
        return cls(path, {CELL: pl.Int64, TRIAL: pl.Int64, **campaign.schema}, campaign.keys)

    @classmethod
    def open(
        cls, out: Path, manifest: Mapping[str, Any], schema: Mapping[str, Any], *, keys: tuple[str, ...] = ()
    ) -> Self:
        """Return the folder of a campaign under ``out``, made if it does not exist.

        Args:
            out: the folder of all campaigns.
            manifest: JSON of all that determines a trial; ``campaign`` is its name.
            schema: columns of a trial's row.
            keys: columns that distinguish the rows of one trial.

        Raises:
            ForeignFolderError: the folder exists with another manifest.
            OSError: it cannot be made.
        """
        text = json.dumps(manifest, indent=2, sort_keys=True) + "\n"
        digest = hashlib.sha256(text.encode()).hexdigest()[:10]
        columns = {CELL: pl.Int64, TRIAL: pl.Int64, **schema}
        folder = cls(out / f"{manifest['campaign']}-{digest}", columns, keys)
        folder.path.mkdir(parents=True, exist_ok=True)
        file = folder.path / MANIFEST
        if not file.exists():
            if any(folder.path.iterdir()):
                raise ForeignFolderError(folder.path, "has no manifest.json, but is not empty")
            with whole_file(file, durable=True) as stream:
                stream.write(text.encode())
        elif file.read_text("utf-8") != text:
            raise ForeignFolderError(folder.path, "its manifest.json is of another campaign")
        return folder

    @property
    def trials_file(self) -> Path:
        """Path of the file of all trials, once the campaign is complete."""
        return self.path / "trials.parquet"

    @property
    def report(self) -> Path:
        """Path of the report."""
        return self.path / "report.html"

    def manifest_digest(self) -> str:
        """Return SHA-256 of the manifest; empty if it cannot be read."""
        try:
            return hashlib.sha256((self.path / MANIFEST).read_bytes()).hexdigest()
        except OSError:
            return ""

    def read(self) -> pl.DataFrame:
        """Return all stored rows, each trial once, in the order of cells and trials."""
        for _ in range(_READS - 1):
            try:
                return self._read()
            except FileNotFoundError:  # another run has merged this file with others
                continue
        return self._read()

    def _read(self) -> pl.DataFrame:
        files = [*self._parts(), self.trials_file]
        frames = [pl.read_parquet(file) for file in files if file.exists()]
        rows = pl.concat(frames) if frames else pl.DataFrame(schema=self.schema)
        order = (CELL, TRIAL, *self.keys)
        return rows.unique(order, keep="last", maintain_order=True).sort(order)

    def add(self, rows: Sequence[Row]) -> None:
        """Store a batch of rows, all of them or none."""
        if rows:
            name = f"{time.time_ns()}-{os.getpid()}"  # two runs at the same time use different names
            self.write_part(name, pl.DataFrame(rows, schema=self.schema))

    def write_part(self, name: str, rows: pl.DataFrame) -> None:
        """Store rows as a part with a name; a part with the same name is replaced. Raises OSError."""
        with whole_file(self.path / f"part-{name}.parquet") as stream:
            rows.write_parquet(stream)

    def compact(self) -> None:
        """Merge the parts into one file if there are many."""
        if len(self._parts()) > _MOST_PARTS:
            self.close()

    def close(self) -> pl.DataFrame:
        """Merge all parts into one file and return its rows."""
        parts, rows = self._parts(), self.read()
        if parts:
            with whole_file(self.trials_file) as stream:
                rows.write_parquet(stream)
            for part in (*parts, *self._abandoned()):
                part.unlink(missing_ok=True)
        return rows

    def most_alike(self) -> tuple[Path, tuple[str, ...]] | None:
        """Return the same campaign's folder beside this one with the fewest differences, and their names.

        A folder whose manifest cannot be read is left out.
        """
        mine = json.loads((self.path / MANIFEST).read_text("utf-8"))
        others = []
        for file in self.path.parent.glob(f"{mine['campaign']}-*/{MANIFEST}"):
            theirs = _read_manifest(file)
            if theirs is None:
                continue
            differs = tuple(key for key in mine if mine[key] != theirs.get(key))
            if differs:
                others.append((file.parent, differs))
        return min(others, key=lambda other: len(other[1]), default=None)

    def _parts(self) -> list[Path]:
        return sorted(self.path.glob("part-*.parquet"))

    def _abandoned(self) -> list[Path]:
        """Return the unfinished files of processes that were killed: older than writing a part takes."""
        before_s, found = time.time() - _ABANDONED_S, []
        for file in self.path.glob("part-*.tmp"):
            with suppress(FileNotFoundError):  # it was finished in this moment
                if file.stat().st_mtime < before_s:
                    found.append(file)
        return found


def _read_manifest(file: Path) -> dict[str, Any] | None:
    """Return a manifest; None if it cannot be read."""
    try:
        manifest = json.loads(file.read_bytes())
    except (OSError, ValueError):
        return None
    return manifest if isinstance(manifest, dict) else None


def cell_parameters(cell: Any) -> dict[str, Any]:
    """Return the parameters of a cell as JSON values."""
    parameters: dict[str, Any] = json.loads(json.dumps(asdict(cell), default=str))
    return parameters
