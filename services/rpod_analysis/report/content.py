"""All that a report tells of one log, gathered in one pass and ready for the page."""

import json
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import plotly.graph_objects as go
import plotly.io

from rpod_analysis.log import Log
from rpod_analysis.log.accounting import Command, SensorFlow
from rpod_analysis.log.completeness import Statement, find_statement
from rpod_analysis.log.unreadable import UnreadableKind
from rpod_analysis.report.figures import error_figure, state_figure
from rpod_analysis.report.figures_path import path_figure
from rpod_analysis.report.figures_statistics import consistency_figure, timing_figure
from rpod_analysis.report.plot_data import Digest
from rpod_analysis.report.snapshots import Snapshot, take_snapshots
from rpod_analysis.scoring.run import StreamedRun
from rpod_analysis.scoring.run_checks import Check, find_checks, headline, verdict
from rpod_analysis.scoring.summarise import summarise
from rpod_analysis.scoring.totals import Tally
from rpod_schemas.logs import SOFTWARE, TopicCount
from rpod_schemas.summary import Summary
from rpod_schemas.topics import DEPTH, POINTS
from rpod_target import Target, TargetError, load_target

_PLOT = {"displaylogo": False, "responsive": True, "modeBarButtonsToRemove": ["lasso2d", "select2d"]}
_MOST_REASONS = 8


@dataclass(frozen=True, eq=False)
class Story:
    """Of one log."""

    name: str
    """Of the log, to tell it from others."""
    files: tuple[str, ...]
    summary: Summary
    tally: Tally
    digest: Digest
    statement: Statement
    counts: dict[str, TopicCount]
    """The logger's own account by topic; empty where it left none."""
    flows: tuple[SensorFlow, ...]
    commands: tuple[tuple[float | None, Command], ...]
    """What services were asked, and when, s from the start of the run; of many the first.

    None where the clock is not the wall's, by which services stamp their diagnostics.
    """
    command_count: int
    alarms: tuple[tuple[str, int], ...]
    """Errors that services reported, the most frequent first."""
    checks: tuple[Check, ...]
    snapshots: tuple[Snapshot, ...]
    unreadable: tuple[UnreadableKind, ...]
    """Messages that cannot be read."""
    target: str
    target_note: str
    software: str
    configuration: dict[str, str]
    """JSON by service."""

    @property
    def verdict(self) -> str:
        """The run in one sentence."""
        return verdict(list(self.checks))

    @property
    def went_well(self) -> bool:
        """Whether no check failed."""
        return all(check.good is not False for check in self.checks)

    @property
    def headline(self) -> str:
        """What is to be known first: complete, lost, worst errors."""
        return headline(self.summary, self.tally)

    @property
    def reasons(self) -> list[tuple[str, int]]:
        """Why frames were rejected, most frequent first, whatever the numbers in the reason."""
        return self.tally.reasons.most_common(_MOST_REASONS)

    def figures(self, prefix: str = "") -> dict[str, str]:
        """Return the figures as HTML by name, empty where nothing is to be drawn; ``prefix`` of their ids."""
        scored = self.digest.angle_deg.values.size
        drawn = {
            "state": state_figure(self.digest),
            "errors": error_figure(self.digest) if scored else None,
            "consistency": consistency_figure(self.digest, self.tally),
            "timing": timing_figure(self.tally),
            "path": path_figure(self.digest),
        }
        return {name: figure_html(figure, f"{prefix}figure-{name}") for name, figure in drawn.items()}


def tell(log: Log, run: StreamedRun, *, name: str, report: Path | None = None) -> Story:
    """Go through a run once and return what is to be told of it; ``report`` where it will stand."""
    tally = Tally()
    digest = Digest(run.start_ns, run.end_ns, tuple(run.sensors))
    for minute in run:
        tally.take(minute)
        digest.take(minute)
    software = log.metadata(SOFTWARE)
    target, target_note = _target(log, software.get("target_digest", "").split())
    alarms = run.account.alarms
    snapshots = tuple(take_snapshots(log, run, digest, target))
    summary = summarise(log, run, tally, report=report)  # last: it tells what could not be read
    return Story(
        name=name,
        files=tuple(path.name for path in log.paths),
        summary=summary,
        tally=tally,
        digest=digest,
        statement=find_statement(log),
        counts=log.counts,
        commands=tuple(
            (None if run.clock else (command.stamp_ns - run.start_ns) * 1e-9, command)
            for command in run.account.commands
        ),
        command_count=run.account.command_count,
        flows=tuple(_flows(run, tally, summary)),
        alarms=tuple(alarms.most_common(_MOST_REASONS)),
        checks=tuple(find_checks(summary, alarms.total())),
        snapshots=snapshots,
        unreadable=log.unreadable.kinds,
        target=target.name if target else "",
        target_note=target_note,
        software=" ".join(software[key] for key in ("name", "version") if key in software),
        configuration={name: json.dumps(model, indent=2) for name, model in log.configuration.items()},
    )


def figure_html(figure: go.Figure | None, identity: str) -> str:
    """Return a figure as HTML without plotly itself, empty where there is none."""
    if figure is None:
        return ""
    options: dict[str, Any] = {"config": _PLOT, "full_html": False, "include_plotlyjs": False}
    return str(plotly.io.to_html(figure, div_id=identity, **options))


def _flows(run: StreamedRun, tally: Tally, summary: Summary) -> list[SensorFlow]:
    flows = []
    for sensor in run.sensors.values():
        topic = (DEPTH if sensor.kind == "pmd" else POINTS).of(sensor.name)
        outcomes = tally.by_sensor.get(sensor.name, Counter[str]())
        dropped, incomplete = run.account.passed_over(run.status_topic, sensor.name)
        flows.append(
            SensorFlow(
                sensor=sensor.name,
                published=summary.frames[topic.name].published,
                accepted=outcomes["accepted"],
                rejected=outcomes["rejected"],
                dropped=dropped,
                incomplete=incomplete,
            )
        )
    return flows


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
