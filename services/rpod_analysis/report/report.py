"""The report: one HTML file that opens without a network, with ``summary.json`` and tables beside it.

For several logs there is a report of each, and one more file that compares them.
"""

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined, Template
from plotly.offline import get_plotlyjs

from rpod_analysis.log import open_log
from rpod_analysis.log.log_file import RECOVERED
from rpod_analysis.report.comparison import ROWS, comparison_figure
from rpod_analysis.report.content import ReportContent, figure_html, gather_content
from rpod_analysis.report.tables import write_tables
from rpod_analysis.scoring.run import stream_run
from rpod_schemas.summary import Comparison

_PART = re.compile(r"_\d{4}$")


@dataclass(frozen=True)
class ReportPaths:
    """Paths of the files of a report."""

    html: Path
    summary: Path
    """JSON file: a ``Summary``, or a ``Comparison`` for several runs."""


def write_report(logs: Sequence[Path], out: Path | None = None) -> ReportPaths:
    """Write ``report.html`` and ``summary.json`` of a run, and its tables and trajectories beside them.

    Args:
        logs: the run's log, or its parts.
        out: directory to write to, by default that of the log.

    Raises:
        AnalysisError: a log cannot be read, or contains no estimates.
    """
    paths, _ = _report_one(logs, out, name="")
    return paths


def write_comparison(runs: Sequence[Sequence[Path]], out: Path | None = None) -> ReportPaths:
    """Write a report of each run, as ``write_report`` does, and their comparison in ``comparison.html``.

    Args:
        runs: the log of each run, or its parts.
        out: directory to write to, with a folder for each log. By default each report is written beside its
            log (if several logs are in one folder, into a folder for each), and the comparison into the
            folder that contains them all.

    Raises:
        AnalysisError: a log cannot be read, or contains no estimates.
    """
    names, contents = unique_names([logs[0] for logs in runs]), []
    folders = [logs[0].absolute().parent for logs in runs]
    for logs, name, folder in zip(runs, names, folders, strict=True):
        alone = out is None and folders.count(folder) == 1
        contents.append(_report_one(logs, None if alone else (out or folder) / name, name=name)[1])
    directory = out or Path(os.path.commonpath(folders))
    paths = ReportPaths(directory / "comparison.html", directory / "comparison.json")
    page = _template("comparison.html.j2").render(
        contents=contents, rows=ROWS, figure=figure_html(comparison_figure(contents), "figure-comparison"),
        plotly=get_plotlyjs(),
    )  # fmt: skip
    paths.html.write_text(page, encoding="utf-8")
    comparison = Comparison(report=str(paths.html), runs=tuple(content.summary for content in contents))
    paths.summary.write_text(comparison.model_dump_json(indent=2) + "\n", encoding="utf-8")
    return paths


def group_parts(paths: Sequence[Path]) -> list[list[Path]]:
    """Return logs grouped by run: ``run.mcap`` and ``run_0002.mcap`` in one folder are parts of one run."""
    runs: dict[tuple[Path, str], list[Path]] = {}
    for path in paths:
        stem = path.name if path.is_dir() else path.stem.removesuffix(RECOVERED)
        runs.setdefault((path.absolute().parent, _PART.sub("", stem)), []).append(path)
    return list(runs.values())


def unique_names(paths: Sequence[Path]) -> list[str]:
    """Return a name for each log: its file's name; for equal names its folder's; else with a number."""
    absolute = [path.absolute() for path in paths]
    choices = (
        [path.stem for path in absolute],
        [path.parent.name for path in absolute],
        [f"{path.parent.name}-{number}" for number, path in enumerate(absolute, start=1)],
    )
    return next(names for names in choices if len(set(names)) == len(names))


def _report_one(logs: Sequence[Path], out: Path | None, *, name: str) -> tuple[ReportPaths, ReportContent]:
    with open_log(*logs) as log:
        run = stream_run(log)
        directory = out or log.paths[0].parent
        paths = ReportPaths(directory / "report.html", directory / "summary.json")
        content = gather_content(log, run, name=name, report=paths.html)
    directory.mkdir(parents=True, exist_ok=True)
    write_tables(directory, run)
    page = _template("report.html.j2").render(content=content, plotly=get_plotlyjs())
    paths.html.write_text(page, encoding="utf-8")
    paths.summary.write_text(content.summary.model_dump_json(indent=2) + "\n", encoding="utf-8")
    return paths, content


def _template(name: str) -> Template:
    return Environment(
        loader=PackageLoader("rpod_analysis"), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    ).get_template(name)
