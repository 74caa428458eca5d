"""From a run to ``summary.json``."""

from pathlib import Path

import numpy as np

from rpod_analysis.log import Log
from rpod_analysis.run import Run
from rpod_analysis.score import (
    find_lost_s,
    summarise_consistency,
    summarise_durations,
    summarise_errors,
)
from rpod_schemas.config.logger import LoggerConfig
from rpod_schemas.summary import EstimateCount, Summary, Tracking
from rpod_schemas.types import Mode


def summarise(log: Log, run: Run, *, report: Path | None = None) -> Summary:
    """Return the summary of a run, read from its log."""
    tracked = run.errors.at(run.tracked)
    return Summary(
        scenario=_scenario(log),
        seed=_seed(log),
        duration_s=run.duration_s,
        log=str(log.paths[0]),
        logs=tuple(str(path) for path in log.paths),
        report=str(report) if report else None,
        frames=run.account.frames(),
        estimates=EstimateCount(
            count=len(run.estimates),
            accepted=int(run.statuses.accepted.sum()),
            rejected=int((~run.statuses.accepted).sum()),
            dropped=run.account.dropped(run.status_topic),
            unscored=int((~run.errors.scored).sum()),
            lost_s=find_lost_s(run.statuses.stamp_ns, run.statuses.mode),
        ),
        modes=find_tracking(run),
        error=summarise_errors(tracked),
        latency_s=summarise_durations(run.latency_s),
        processing_s=summarise_durations(run.statuses.processing_s),
        consistency=summarise_consistency(tracked.nees),
    )


def find_tracking(run: Run) -> Tracking:
    """Return how well a run held the target."""
    held = run.statuses.mode == Mode.TRACKING
    first = int(np.argmax(held)) if held.any() else None
    scored = run.tracked & run.errors.scored
    return Tracking(
        first_tracking_s=None if first is None else run.seconds(run.statuses.stamp_ns)[first],
        tracking_share=None if first is None else held[first:].mean(),
        worse_than_10deg_or_0_3m_share=run.errors.off_target[scored].mean() if scored.any() else None,
    )


def _scenario(log: Log) -> str | None:
    """Return the name under which the run was recorded: ``rpod run`` gives the scenario's to the logger."""
    name = log.configuration.get(LoggerConfig.model_fields["instance"].default, {}).get("name")
    return str(name) if name else None


def _seed(log: Log) -> int | None:
    """Return the first seed that a service was configured with."""
    seeds = [service["seed"] for service in log.configuration.values() if service.get("seed") is not None]
    return int(seeds[0]) if seeds else None
