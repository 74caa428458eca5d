"""The folder of a campaign: what it was asked for, and every trial as soon as it is done.

The folder's name holds a digest of all that decides a trial: parameters of the cells, seed, software. The
same campaign finds its folder again and goes on where it stopped; any change makes another folder.
"""

import hashlib
import json
import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Self

import polars as pl

from rpod_campaign.engine.campaign import CELL, TRIAL, AnyCampaign, Row
from rpod_campaign.engine.errors import ForeignFolderError

MANIFEST = "manifest.json"
_MOST_PARTS = 256
"""More files of rows than this are made one while the campaign runs."""
_READS = 5
"""Attempts to read while another run of the campaign may be making one file of several."""


@dataclass(frozen=True)
class CampaignFolder:
    """Where the trials of one campaign are kept."""

    path: Path
    schema: Mapping[str, Any]
    """Columns of the rows, with cell and trial in front."""
    keys: tuple[str, ...] = ()
    """Columns that tell the rows of one trial apart."""

    @classmethod
    def of(cls, campaign: AnyCampaign, path: Path) -> Self:
        """Return the folder of a campaign that stands at a path; nothing is read or made."""
        return cls(path, {CELL: pl.Int64, TRIAL: pl.Int64, **campaign.schema}, campaign.keys)

    @classmethod
    def open(
        cls, out: Path, manifest: Mapping[str, Any], schema: Mapping[str, Any], *, keys: tuple[str, ...] = ()
    ) -> Self:
        """Return the folder of a campaign under ``out``, made where there is none.

        Args:
            out: the folder of all campaigns.
            manifest: JSON of all that decides a trial; ``campaign`` is its name.
            schema: columns of a trial's row.
            keys: those of them that tell the rows of one trial apart.

        Raises:
            ForeignFolderError: the folder is there, with another manifest.
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
            _write_whole(file, text.encode())
        elif file.read_text("utf-8") != text:
            raise ForeignFolderError(folder.path, "its manifest.json is of another campaign")
        return folder

    @property
    def trials_file(self) -> Path:
        """All trials, once the campaign is complete."""
        return self.path / "trials.parquet"

    @property
    def report(self) -> Path:
        """The report."""
        return self.path / "report.html"

    def manifest_digest(self) -> str:
        """Return SHA-256 of the manifest; empty if it cannot be read."""
        try:
            return hashlib.sha256((self.path / MANIFEST).read_bytes()).hexdigest()
        except OSError:
            return ""

    def read(self) -> pl.DataFrame:
        """Return all rows that are there, each trial once, in the order of cells and trials."""
        for _ in range(_READS - 1):
            try:
                return self._read()
            except FileNotFoundError:  # another run made one file of this and others
                continue
        return self._read()

    def _read(self) -> pl.DataFrame:
        files = [*self._parts(), self.trials_file]
        frames = [pl.read_parquet(file) for file in files if file.exists()]
        rows = pl.concat(frames) if frames else pl.DataFrame(schema=self.schema)
        order = (CELL, TRIAL, *self.keys)
        return rows.unique(order, keep="last", maintain_order=True).sort(order)

    def add(self, rows: Sequence[Row]) -> None:
        """Keep a batch of rows; it appears whole or not at all."""
        if rows:
            name = f"{time.time_ns()}-{os.getpid()}"  # two runs at once do not meet
            self.write_part(name, pl.DataFrame(rows, schema=self.schema))

    def write_part(self, name: str, rows: pl.DataFrame) -> None:
        """Keep rows as a part of a name; a part of the same name is replaced. Raises OSError."""
        self._write(self.path / f"part-{name}.parquet", rows)

    def compact(self) -> None:
        """Make one file of the parts if they are many."""
        if len(self._parts()) > _MOST_PARTS:
            self.close()

    def close(self) -> pl.DataFrame:
        """Make one file of all batches and return its rows."""
        parts, rows = self._parts(), self.read()
        if parts:
            self._write(self.trials_file, rows)
            for part in parts:
                part.unlink(missing_ok=True)
        return rows

    def most_alike(self) -> tuple[Path, tuple[str, ...]] | None:
        """Return the folder of the same campaign beside this one that differs least, and in what."""
        mine = json.loads((self.path / MANIFEST).read_text("utf-8"))
        others = []
        for file in self.path.parent.glob(f"{mine['campaign']}-*/{MANIFEST}"):
            theirs = json.loads(file.read_text("utf-8"))
            differs = tuple(key for key in mine if mine[key] != theirs.get(key))
            if differs:
                others.append((file.parent, differs))
        return min(others, key=lambda other: len(other[1]), default=None)

    def _parts(self) -> list[Path]:
        return sorted(self.path.glob("part-*.parquet"))

    @staticmethod
    def _write(file: Path, rows: pl.DataFrame) -> None:
        temporary = file.with_suffix(f".{os.getpid()}.tmp")
        rows.write_parquet(temporary)
        temporary.replace(file)


def cell_parameters(cell: Any) -> dict[str, Any]:
    """Return the parameters of a cell as JSON has them."""
    parameters: dict[str, Any] = json.loads(json.dumps(asdict(cell), default=str))
    return parameters


def _write_whole(file: Path, content: bytes) -> None:
    temporary = file.with_suffix(f".{os.getpid()}.tmp")
    temporary.write_bytes(content)
    temporary.replace(file)
