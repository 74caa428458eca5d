"""``rpod report`` from its arguments to its exit code."""

import sys
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from rpod.summary_table import print_summary
from rpod_analysis import AnalysisError
from rpod_analysis.report import write_report
from rpod_runtime.lifecycle import EXIT_FAILURE, EXIT_OK
from rpod_schemas.summary import Summary


def report_command(logs: Sequence[Path], *, as_json: bool) -> int:
    """Write report and summary of a log; return the exit code."""
    try:
        paths = write_report(logs)
    except AnalysisError as error:
        print(f"rpod report: {error}", file=sys.stderr)
        return EXIT_FAILURE
    summary = Summary.model_validate_json(paths.summary.read_text("utf-8"))
    if as_json:
        print(summary.model_dump_json(indent=2))
    else:
        console = Console()
        print_summary(summary, console)
        console.print(f"report   {paths.html}", soft_wrap=True, highlight=False)
    return EXIT_OK
