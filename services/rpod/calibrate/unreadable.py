"""Prints which messages of a log were left out."""

import sys

from rpod_analysis.log import Log


def print_unreadable(verb: str, *logs: Log) -> None:
    """Print a line on standard error for each topic and reason of messages that cannot be read."""
    for log in logs:
        for kind in log.unreadable.kinds:
            print(
                f"{verb}: {log.paths[0].name}: {kind.count} messages of {kind.topic} cannot be read "
                f"and are left out ({kind.reason}: {kind.example})",
                file=sys.stderr,
            )
