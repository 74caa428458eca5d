"""Options that several verbs share, and the check of the part of a log that a verb reads."""

from math import inf
from typing import Annotated

import typer

from rpod_schemas.errors import ConfigurationError


def check_part(start_s: float, end_s: float | None) -> None:
    """Check the values of ``--from`` and ``--to``. Raises ``ConfigurationError``."""
    for name, time_s in (("--from", start_s), ("--to", end_s)):
        if time_s is not None and not 0.0 <= time_s < inf:
            raise ConfigurationError(name, "", f"is {time_s:g}; give seconds from the log's beginning")
    if end_s is not None and end_s <= start_s:
        raise ConfigurationError("--to", "", f"is {end_s:g}, not after --from {start_s:g}; give a later time")


JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object only.")]


def _lift(context: typer.Context, value: bool) -> None:
    if value:
        from rpod_analysis.log.limits import lifted  # noqa: PLC0415 - a verb imports what it needs

        context.with_resource(lifted())


NoLimits = Annotated[
    bool,
    typer.Option(
        "--no-limits",
        callback=_lift,
        help="Also read files that announce more bytes or channels than the limits allow. Use it only "
        "for files that you trust.",
    ),
]
"""Lifts the limits of ``rpod_analysis.log.limits`` while the verb runs."""
