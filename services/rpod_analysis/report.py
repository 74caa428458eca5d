"""The report: one HTML file that opens without a network, and ``summary.json`` beside it."""

import json
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import plotly.io
from jinja2 import Environment, PackageLoader, StrictUndefined
from plotly.offline import get_plotlyjs

from rpod_analysis.figures import error_figure, histogram_figure, state_figure
from rpod_analysis.log import Log, open_log
from rpod_analysis.run import Run, read_run
from rpod_analysis.snapshots import take_snapshots
from rpod_analysis.summarise import summarise
from rpod_analysis.tables import write_tables
from rpod_analysis.verdict import find_checks, verdict
from rpod_schemas.logs import SOFTWARE
from rpod_schemas.summary import Summary
from rpod_target import Target, TargetError, load_target

_PLOT = {"displaylogo": False, "responsive": True, "modeBarButtonsToRemove": ["lasso2d", "select2d"]}
_MOST_REASONS = 8
_NUMBER = re.compile(r"(?<![A-Za-z])-?\d+(\.\d+)?(e-?\d+)?")


@dataclass(frozen=True)
class ReportPaths:
    """What was written."""

    html: Path
    summary: Path


def write_report(logs: Sequence[Path], out: Path | None = None) -> ReportPaths:
    """Write ``report.html`` and ``summary.json`` of a run, and its tables and trajectories beside them.

    Args:
        logs: the run's log, or its parts.
        out: directory to write to; beside the log where left out.

    Raises:
        AnalysisError: a log cannot be read, or no estimator spoke in it.
    """
    with open_log(*logs) as log:
        run = read_run(log)
        directory = out or log.paths[0].parent
        paths = ReportPaths(directory / "report.html", directory / "summary.json")
        summary = summarise(log, run, report=paths.html)
        page = render(log, run, summary)
    directory.mkdir(parents=True, exist_ok=True)
    write_tables(directory, run)
    paths.html.write_text(page, encoding="utf-8")
    paths.summary.write_text(summary.model_dump_json(indent=2) + "\n", encoding="utf-8")
    return paths


def render(log: Log, run: Run, summary: Summary) -> str:
    """Return the report as HTML."""
    software = log.metadata(SOFTWARE)
    target, target_note = _target(log, software.get("target_digest", "").split())
    checks = find_checks(summary, len(run.alarms))
    environment = Environment(
        loader=PackageLoader("rpod_analysis"), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    return environment.get_template("report.html.j2").render(
        summary=summary,
        files=[path.name for path in log.paths],
        verdict=verdict(checks),
        went_well=all(check.good is not False for check in checks),
        checks=checks,
        target=target.name if target else "",
        target_note=target_note,
        version=" ".join(software[key] for key in ("name", "version") if key in software),
        figures={
            "errors": _html(error_figure(run)) if run.errors.scored.any() else "",
            "state": _html(state_figure(run)),
            "histograms": _html(histogram_figure(run)) if summary.processing_s or summary.latency_s else "",
        },
        snapshots=take_snapshots(log, run, target),
        reasons=_reasons(run),
        alarms=[f"{alarm.name}: {alarm.message}" for alarm in run.alarms[:_MOST_REASONS]],
        configuration={name: json.dumps(model, indent=2) for name, model in log.configuration.items()},
        plotly=get_plotlyjs(),
    )


def _target(log: Log, digests: list[str]) -> tuple[Target | None, str]:
    """Return the target that the services were configured for, and what is to be said of its wireframe."""
    names = [service["target"] for service in log.configuration.values() if service.get("target")]
    if not names:
        return None, "No wireframe: the log does not say which target it is."
    try:
        target = load_target(names[0])
    except TargetError as error:
        return None, f"No wireframe: {error}"
    changed = bool(digests) and target.digest not in digests
    return target, "The target's parameters have changed since the run." * changed


def _reasons(run: Run) -> list[tuple[str, int]]:
    """Return why frames were rejected, most frequent first, whatever the numbers in the reason."""
    reasons = run.statuses.reason[~run.statuses.accepted]
    kinds = Counter(_NUMBER.sub("…", str(reason)) or "no reason given" for reason in reasons)
    return kinds.most_common(_MOST_REASONS)


def _html(figure: Any) -> str:
    return str(plotly.io.to_html(figure, config=_PLOT, full_html=False, include_plotlyjs=False))
