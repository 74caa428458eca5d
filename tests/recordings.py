"""Reading what a view drew, with Rerun's own reader."""

from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from rerun.chunk import RrdReader


@dataclass
class Entity:
    """What was logged of an entity, in the order of time."""

    stamps_ns: list[int] = field(default_factory=list)
    columns: dict[str, list[Any]] = field(default_factory=lambda: defaultdict(list))
    """By component, as ``Scalars:scalars``; of each stamp, or of the static data."""

    def sort(self) -> None:
        """Bring chunks, which come as they were written, into the order of time."""
        order = np.argsort(self.stamps_ns, kind="stable")
        self.stamps_ns = [self.stamps_ns[k] for k in order]
        for name, rows in self.columns.items():
            if len(rows) == len(order):
                self.columns[name] = [rows[k] for k in order]

    def values(self, component: str) -> Any:
        """Return a component as an array, first instance of each stamp."""
        return np.array([row[0] for row in self.columns[component]])


def read_recording(path: Path) -> dict[str, Entity]:
    """Return the entities of a recording by path, without the leading slash."""
    entities: dict[str, Entity] = defaultdict(Entity)
    for chunk in RrdReader(path).stream():
        entity = entities[str(chunk.entity_path).removeprefix("/")]
        batch = chunk.to_record_batch()
        for name, column in zip(batch.schema.names, batch.columns, strict=True):
            if name == "time":
                entity.stamps_ns += column.cast("int64").to_pylist()
            elif ":" in name:
                entity.columns[name] += column.to_pylist()
    for entity in entities.values():
        entity.sort()
    return dict(entities)


def blueprints(path: Path) -> int:
    """Return how often the screen was divided."""
    return len(RrdReader(path).blueprints())
