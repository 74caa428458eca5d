"""The scores as one table for a terminal."""

from collections.abc import Sequence

from rich.table import Table

from peers.benchmark import Score


def table(scores: Sequence[Score], *, title: str) -> Table:
    """Return the table, a line for each peer and range or start, parted by task.

    The median error is that of the successes.
    """
    made = Table(title=title, title_justify="left")
    for column in ("task", "peer", "package"):
        made.add_column(column)
    for column in (
        "range m",
        "from",
        "success",
        "95 % Wilson",
        "no pose",
        "median ms",
        "median deg",
        "median mm",
    ):
        made.add_column(column, justify="right")
    for index, score in enumerate(scores):
        last = index + 1 == len(scores) or scores[index + 1].task is not score.task
        made.add_row(*_words(score), end_section=last)
    return made


def _words(score: Score) -> tuple[str, ...]:
    error_deg = score.median_error_deg
    return (
        score.task,
        score.peer,
        score.package.partition("-python")[0],
        "" if score.range_m is None else f"{score.range_m:g}",
        score.start,
        f"{score.success_rate:.3f}",
        f"{score.wilson_low:.3f} to {score.wilson_high:.3f}",
        f"{score.no_pose}",
        f"{score.median_s * 1e3:.2f}",
        "-" if error_deg is None else f"{error_deg:.3f}",
        "-" if score.median_error_m is None else f"{1e3 * score.median_error_m:.1f}",
    )
