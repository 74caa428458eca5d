"""The section of a report that names the model used for each target, where the two differ."""

from collections.abc import Sequence
from typing import Any

from rpod_campaign.engine.report.content import Section, Table


def models_section(cells: Sequence[Any]) -> list[Section]:
    """Return the section with each target and its model; none if every model is the target itself."""
    with_models = (cell for cell in cells if hasattr(cell, "model"))  # another package's may have none
    pairs = dict.fromkeys(
        (cell.target, cell.model) for cell in with_models if cell.model not in ("", cell.target)
    )
    if not pairs:
        return []
    note = "What is seen is the truth; what the methods look for is the model. Errors are those to the truth."
    return [Section("Models", note, (Table("", ("truth T", "model M"), tuple(pairs)),))]
