"""Configuration of the logger: topics, files, and when a file is closed for the next one."""

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from rpod_schemas.config.base import LIVE, Name, Positive
from rpod_schemas.config.service import ServiceConfig


class LoggerConfig(ServiceConfig):
    """Configuration of the logger, which writes MCAP files."""

    instance: Name = "logger"
    """Name on the bus."""
    directory: Annotated[Path, LIVE] = Path("runs")
    """Folder of the logs; it is made if it is missing. It changes without a restart, for the next file."""
    name: str | None = Field(default=None, pattern=r"^[A-Za-z0-9._-]+$")
    """Stem of the file's name; the time of the start if left out."""
    compression: Literal["lz4", "zstd", "none"] = "lz4"
    """Compression of the chunks."""
    chunk_bytes: int = Field(default=1 << 20, ge=1 << 12, le=1 << 24)
    """Size of a chunk, bytes."""
    sync_interval_s: Annotated[Positive, LIVE] = 1.0
    """Interval at which the open chunk is flushed and synced to the disk, s. It changes without a restart."""
    queue_bytes: int = Field(default=256 << 20, ge=1 << 20)
    """Capacity of the queue between bus and disk, bytes."""
    split_bytes: Annotated[int, LIVE] = Field(default=3_500_000_000, ge=1 << 16)
    """Size at which a file is closed and the next one opened, bytes; it is below the limit of any file
    system. It also bounds the index, which the writer keeps in memory until the close. It changes
    without a restart."""
    split_interval_s: Annotated[Positive | None, LIVE] = None
    """Age at which a file is closed and the next one opened, s; no limit if left out. It changes without a
    restart."""
    reserve_bytes: int = Field(default=16 << 20, ge=1 << 16)
    """Space that is kept free on the disk, bytes, so that a file can be closed when the disk is full: for the
    chunk that did not fit, and for the index."""
    digest_chain: bool | None = None
    """Whether a digest chain is written beside each file, by which ``rpod verify-log`` finds later changes.
    By default it is on a secure bus, where the logger's key signs it; elsewhere it has no signature."""
    record_extra: tuple[str, ...] = ()
    """Key expressions to record besides the ICD's topics."""

    @property
    def chained(self) -> bool:
        """Whether a digest chain is written."""
        return self.bus.credentials is not None if self.digest_chain is None else self.digest_chain

    @model_validator(mode="after")
    def _room_for_the_last_chunk(self) -> Self:
        if self.reserve_bytes < 2 * self.chunk_bytes:
            raise ValueError(
                f"reserve_bytes is {self.reserve_bytes}, needs at least two chunks of chunk_bytes "
                f"({2 * self.chunk_bytes})"
            )
        return self
