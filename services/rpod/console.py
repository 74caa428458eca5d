"""Where the verbs print their tables."""

import sys

from rich.console import Console


def table_console(*, plain_width: int = 160) -> Console:
    """Return a console on standard output; a table in a file or a pipe is not folded to 80 columns.

    Args:
        plain_width: width of a line where standard output is no terminal, characters.
    """
    return Console(markup=False, width=None if sys.stdout.isatty() else plain_width)
