"""Options that the verbs that read logs share."""

from typing import Annotated

import typer


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
