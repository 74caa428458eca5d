"""``rpod report`` from its arguments to its exit code."""

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from rpod.errors import failed
from rpod.summary_table import print_summary
from rpod_analysis import AnalysisError
from rpod_analysis.report import group_parts, write_comparison, write_report
from rpod_runtime.process.lifecycle import EXIT_OK
from rpod_schemas.summary import Comparison, Summary


def _run_name(summary: Summary) -> str:
    """Return the name of the log's folder, which runs of one scenario do not share."""
    return Path(summary.log).parent.name or summary.log


def report_command(logs: Sequence[Path], *, out: Path | None, as_json: bool) -> int:
    """Write report and summary of a log, or of several and their comparison; return the exit code."""
    runs = group_parts(logs)
    try:
        paths = write_report(runs[0], out) if len(runs) == 1 else write_comparison(runs, out)
    except (AnalysisError, OSError) as error:
        return failed("report", error)
    text = paths.summary.read_text("utf-8")
    if as_json:
        print(text, end="")
        return EXIT_OK
    console = Console(markup=False)
    one = len(runs) == 1
    for summary in [Summary.model_validate_json(text)] if one else Comparison.model_validate_json(text).runs:
        print_summary(summary, console, name="" if one else _run_name(summary))
    console.print(f"report   {paths.html}", soft_wrap=True, highlight=False)
    return EXIT_OK
