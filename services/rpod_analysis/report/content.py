"""Content of the report of one log, collected in one pass over it."""

import json
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import plotly.graph_objects as go
import plotly.io

from rpod_analysis.log import Log
from rpod_analysis.log.accounting import Command, SensorFlow
from rpod_analysis.log.completeness import CheckedCompleteness, check_log_completeness
from rpod_analysis.log.targets import logged_targets
from rpod_analysis.log.unreadable import UnreadableKind
from rpod_analysis.report.figures import PLOT, error_figure, state_figure
from rpod_analysis.report.figures_path import path_figure
from rpod_analysis.report.figures_statistics import consistency_figure, timing_figure
from rpod_analysis.report.plot_data import PlotData
from rpod_analysis.report.snapshots import Snapshot, Wireframes, take_refused, take_snapshots
from rpod_analysis.scoring.fault_scores import FaultScores
from rpod_analysis.scoring.frame_errors import named_frames
from rpod_analysis.scoring.run import StreamedRun
from rpod_analysis.scoring.run_checks import Check, assess, find_checks, headline
from rpod_analysis.scoring.summarise import summarise
from rpod_analysis.scoring.totals import RunTotals
from rpod_schemas.logs import SOFTWARE, TopicCount
from rpod_schemas.summary import Summary
from rpod_target import Target, TargetError, load_target

_MOST_REASONS = 8
_UNKNOWN = "No wireframe, and errors as if the target had no symmetry"


@dataclass(frozen=True, eq=False)
class ReportContent:
    """Content of the report of one log."""

    name: str
    """Name of the log in a comparison."""
    files: tuple[str, ...]
    summary: Summary
    totals: RunTotals
    plot_data: PlotData
    completeness: CheckedCompleteness
    counts: dict[str, TopicCount]
    """The logger's own counts by topic; empty if it wrote none."""
    flows: tuple[SensorFlow, ...]
    commands: tuple[tuple[float | None, Command], ...]
    """Times, s from the start of the run, and commands that services accepted; the first ones only.

    The time is None if the run does not use the wall clock, by which services stamp their diagnostics.
    """
    command_count: int
    alarms: tuple[tuple[str, int], ...]
    """Errors that services reported, the most frequent first."""
    checks: tuple[Check, ...]
    snapshots: tuple[Snapshot, ...]
    refused: tuple[Snapshot, ...]
    """Frames that were refused for their pixels, with these pixels."""
    unreadable: tuple[UnreadableKind, ...]
    """Messages that cannot be read."""
    target: str
    target_note: str
    software: str
    configuration: dict[str, str]
    """Configuration of each service as JSON, by service."""

    @property
    def assessment(self) -> str:
        """Assessment of the run in one sentence."""
        return assess(list(self.checks))

    @property
    def went_well(self) -> bool:
        """Whether every check passed or is unknown."""
        return all(check.good is not False for check in self.checks)

    @property
    def headline(self) -> str:
        """The most important facts in one line: acquisition, losses, worst errors, completeness."""
        return headline(self.summary, self.totals)

    @property
    def reasons(self) -> list[tuple[str, int]]:
        """Reasons of rejected frames, most frequent first; reasons that differ only in numbers are one."""
        return self.totals.reasons.most_common(_MOST_REASONS)

    def figures(self, prefix: str = "") -> dict[str, str]:
        """Return the figures as HTML by name, empty if there are no data; ``prefix`` begins their ids."""
        scored = self.plot_data.angle_deg.values.size
        drawn = {
            "state": state_figure(self.plot_data),
            "errors": error_figure(self.plot_data) if scored else None,
            "consistency": consistency_figure(self.plot_data, self.totals),
            "timing": timing_figure(self.totals),
            "path": path_figure(self.plot_data),
        }
        return {name: figure_html(figure, f"{prefix}figure-{name}") for name, figure in drawn.items()}


def gather_content(log: Log, run: StreamedRun, *, name: str, report: Path | None = None) -> ReportContent:
    """Read a run once and return the content of its report; ``report`` is the path of the page."""
    totals = RunTotals(named_frames(log, prefix=run.prefix), FaultScores(run.faults, run.end_ns))
    plot_data = PlotData(run.start_ns, run.end_ns, tuple(run.sensors), run.faults)
    for minute in run:
        totals.take(minute)
        plot_data.take(minute)
    software = log.metadata(SOFTWARE)
    wireframes, target_note = _targets(log, run.prefix)
    alarms = run.account.alarms
    snapshots = tuple(take_snapshots(log, run, plot_data, wireframes))
    refused = tuple(take_refused(log, run, wireframes))
    summary = summarise(log, run, totals, report=report)  # last, because it contains what could not be read
    return ReportContent(
        name=name,
        files=tuple(path.name for path in log.paths),
        summary=summary,
        totals=totals,
        plot_data=plot_data,
        completeness=check_log_completeness(log),
        counts=log.counts,
        commands=tuple(
            (None if run.clock else (command.stamp_ns - run.start_ns) * 1e-9, command)
            for command in run.account.commands
        ),
        command_count=run.account.command_count,
        flows=tuple(_flows(run, totals, summary)),
        alarms=tuple(alarms.most_common(_MOST_REASONS)),
        checks=tuple(find_checks(summary, alarms.total())),
        snapshots=snapshots,
        refused=refused,
        unreadable=log.unreadable.kinds,
        target=wireframes.truth.name if wireframes.truth else "",
        target_note=target_note,
        software=_software(software),
        configuration={name: json.dumps(model, indent=2) for name, model in log.configuration.items()},
    )


def figure_html(figure: go.Figure | None, identity: str) -> str:
    """Return a figure as HTML without plotly itself; empty if there is no figure."""
    if figure is None:
        return ""
    options: dict[str, Any] = {"config": PLOT, "full_html": False, "include_plotlyjs": False}
    return str(plotly.io.to_html(figure, div_id=identity, **options))


def _flows(run: StreamedRun, totals: RunTotals, summary: Summary) -> list[SensorFlow]:
    flows = []
    for sensor in run.sensors.values():
        outcomes = totals.by_sensor.get(sensor.name, Counter[str]())
        dropped, incomplete = run.account.passed_over(run.status_topic, sensor.name)
        counted = summary.frames.get(sensor.leading.name)  # a stream that was not recorded has no count
        flows.append(
            SensorFlow(
                sensor=sensor.name,
                published=counted.published if counted else 0,
                accepted=outcomes["accepted"],
                rejected=outcomes["rejected"],
                dropped=dropped,
                incomplete=incomplete,
            )
        )
    return flows


def _targets(log: Log, prefix: str) -> tuple[Wireframes, str]:
    """Return the targets in the services' configurations, and a remark about their wireframes."""
    names = logged_targets(log, prefix=prefix)
    if names.shown is None:
        return Wireframes(None, None), f"{_UNKNOWN}: no configuration in the log names the target."
    try:
        truth = load_target(names.shown)
        model = load_target(names.model or names.shown)
    except TargetError as error:
        return Wireframes(None, None), f"{_UNKNOWN}: {error}"
    return Wireframes(model, truth), _changes(log, truth, model)


def _software(record: dict[str, str]) -> str:
    """Return name and version, and the first digits of the digests of the target's parameters and arrays."""
    text = " ".join(record[key] for key in ("name", "version") if key in record)
    digests = (("target_digest", "target"), ("target_content", "arrays"))
    short = {what: [digest[:12] for digest in record.get(key, "").split()] for key, what in digests}
    return ", ".join([text, *(f"{what} {' '.join(found)}" for what, found in short.items() if found)])


def _changes(log: Log, truth: Target, model: Target) -> str:
    """Return how the targets of this machine differ from those of the run, or which targets it had."""
    software = log.metadata(SOFTWARE)
    digests = software.get("target_digest", "").split()
    contents = software.get("target_content", "").split()
    if digests and not {truth.digest, model.digest} <= set(digests):
        return "The target's parameters have changed since the run."
    if contents and not {truth.content_digest, model.content_digest} <= set(contents):
        return (
            "The target of the run had the same parameters, but other arrays: it was built on another "
            "machine or with other libraries, or its cached file was changed."
        )
    return ""
