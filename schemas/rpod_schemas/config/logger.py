"""The logger: what is recorded, where to, and when a file is closed for the next one."""

from pathlib import Path
from typing import Literal, Self

from pydantic import Field, model_validator

from rpod_schemas.config.base import Name, Positive
from rpod_schemas.config.service import ServiceConfig


class LoggerConfig(ServiceConfig):
    """The MCAP writer."""

    instance: Name = "logger"
    """Name on the bus."""
    directory: Path = Path("runs")
    """Where logs go; made where it is missing."""
    name: str | None = Field(default=None, pattern=r"^[A-Za-z0-9._-]+$")
    """Stem of the file's name; the time of the start where left out."""
    compression: Literal["lz4", "zstd", "none"] = "lz4"
    """Of the chunks."""
    chunk_bytes: int = Field(default=1 << 20, ge=1 << 12, le=1 << 24)
    """Size of a chunk."""
    sync_interval_s: Positive = 1.0
    """How often the open chunk is flushed and synced to the disk."""
    queue_bytes: int = Field(default=256 << 20, ge=1 << 20)
    """Bound of the queue between bus and disk."""
    split_bytes: int = Field(default=3_500_000_000, ge=1 << 16)
    """Size at which a file is closed and the next one opened; below what any file system takes. It also
    bounds the index, which the writer keeps in memory until the close."""
    split_interval_s: Positive | None = None
    """Age at which a file is closed and the next one opened; never where left out."""
    reserve_bytes: int = Field(default=16 << 20, ge=1 << 16)
    """Room that is kept on the disk, so that a file can be closed when the disk is full: for the chunk that
    did not fit, and for the index."""
    record_extra: tuple[str, ...] = ()
    """Key expressions to record beside the ICD's topics."""

    @model_validator(mode="after")
    def _room_for_the_last_chunk(self) -> Self:
        if self.reserve_bytes < 2 * self.chunk_bytes:
            raise ValueError("reserve_bytes needs room for two chunks of chunk_bytes")
        return self
