"""From a run to ``summary.json``."""

from pathlib import Path

from rpod_analysis.log import Log
from rpod_analysis.log.completeness import find_statement
from rpod_analysis.scoring.run import StreamedRun
from rpod_analysis.scoring.totals import Tally, summarise_durations
from rpod_schemas.config.logger import LoggerConfig
from rpod_schemas.summary import EstimateCount, Summary


def summarise(
    log: Log, run: StreamedRun, tally: Tally | None = None, *, report: Path | None = None
) -> Summary:
    """Return the summary of a run, read from its log; ``tally`` where the run was gone through before."""
    tally = tally or Tally.of(*run)
    return Summary(
        scenario=_scenario(log),
        seed=_seed(log),
        duration_s=run.duration_s,
        log=str(log.paths[0]),
        logs=tuple(str(path) for path in log.paths),
        report=str(report) if report else None,
        frames=run.account.frames(),
        estimates=EstimateCount(
            count=tally.estimates,
            accepted=tally.accepted,
            rejected=tally.rejected,
            dropped=run.account.dropped(run.status_topic),
            unscored=tally.unscored,
            lost_s=tally.lost_ns * 1e-9,
        ),
        modes=tally.modes(),
        error=tally.error(),
        latency_s=summarise_durations(tally.latency_s),
        processing_s=summarise_durations(tally.processing_s),
        consistency=tally.consistency(),
        innovation=tally.innovation(),
        completeness=find_statement(log).summary(),
        unreadable=log.unreadable.by_topic(),
    )


def _scenario(log: Log) -> str | None:
    """Return the name under which the run was recorded: ``rpod run`` gives the scenario's to the logger."""
    name = log.configuration.get(LoggerConfig.model_fields["instance"].default, {}).get("name")
    return str(name) if name else None


def _seed(log: Log) -> int | None:
    """Return the first seed that a service was configured with."""
    seeds = [service["seed"] for service in log.configuration.values() if service.get("seed") is not None]
    return int(seeds[0]) if seeds else None
