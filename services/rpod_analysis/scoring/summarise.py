"""Creates the content of a run's ``summary.json``."""

from pathlib import Path

from rpod_analysis.log import Log
from rpod_analysis.log.completeness import check_log_completeness
from rpod_analysis.log.targets import logged_targets
from rpod_analysis.scoring.fault_scores import FaultScores
from rpod_analysis.scoring.frame_errors import named_frames
from rpod_analysis.scoring.joint_errors import joint_errors
from rpod_analysis.scoring.run import StreamedRun
from rpod_analysis.scoring.totals import RunTotals, summarise_durations
from rpod_schemas.config.facility.logger import LoggerConfig
from rpod_schemas.summary import EstimateCount, Summary


def summarise(
    log: Log, run: StreamedRun, totals: RunTotals | None = None, *, report: Path | None = None
) -> Summary:
    """Return the summary of a run, read from its log; ``totals`` if they were added up before."""
    totals = totals or RunTotals.of(
        *run, frames=named_frames(log, prefix=run.prefix), faults=FaultScores(run.faults, run.end_ns)
    )
    targets = logged_targets(log, prefix=run.prefix)
    return Summary(
        scenario=_scenario(log),
        target=targets.truth,
        model=targets.model,
        seed=_seed(log),
        duration_s=run.duration_s,
        log=str(log.paths[0]),
        logs=tuple(str(path) for path in log.paths),
        report=str(report) if report else None,
        frames=run.account.frames(),
        estimates=EstimateCount(
            count=totals.estimates,
            accepted=totals.accepted,
            rejected=totals.rejected,
            dropped=run.account.dropped(run.status_topic),
            unscored=totals.unscored,
            lost_s=totals.lost_ns * 1e-9,
        ),
        inputs=run.account.inputs(run.status_topic),
        bodies=run.account.bodies(run.status_topic),
        modes=totals.modes(),
        error=totals.error(),
        truth_error=totals.truth_error(),
        frame_errors=totals.frame_errors(),
        joint_errors=joint_errors(log, prefix=run.prefix),
        latency_s=summarise_durations(totals.latency_s),
        processing_s=summarise_durations(totals.processing_s),
        consistency=totals.consistency(),
        innovation=totals.innovation(),
        handover=totals.handovers.summary(),
        integrity=totals.integrity.summary(),
        mounts=run.mounts,
        faults=totals.faults.outcomes(run.start_ns),
        completeness=check_log_completeness(log).summary(),
        unreadable=log.unreadable.by_topic(),
    )


def _scenario(log: Log) -> str | None:
    """Return the configured name of the log; ``rpod run`` uses the name of the scenario."""
    name = log.configuration.get(LoggerConfig.model_fields["instance"].default, {}).get("name")
    return str(name) if name else None


def _seed(log: Log) -> int | None:
    """Return the first seed in the services' configurations."""
    seeds = (service.get("seed") for service in log.configuration.values())
    return next((seed for seed in seeds if isinstance(seed, int) and seed >= 0), None)
