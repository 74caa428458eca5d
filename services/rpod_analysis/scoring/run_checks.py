"""Checks of a run: questions with thresholds, answered from its summary."""

from collections.abc import Iterator
from dataclasses import dataclass

from rpod_analysis.scoring.totals import RunTotals
from rpod_schemas.summary import Summary

MIN_TRACKING_SHARE = 0.99
"""Least share of frames in TRACKING after the first acquisition."""
MAX_OFF_TARGET_SHARE = 0.01
"""Largest share of tracked frames whose error exceeds 10 degrees or 0.3 m."""
MIN_NEES_SHARE = 0.80
"""Least share of tracked frames within the 95 % bound; below it the covariance is too small to be used."""
MAX_DROPPED_SHARE = 0.05
"""Largest share of the frames that reached the estimator and were dropped."""

_COMPLETE = {
    True: "the log is complete",
    False: "the log is not complete",
    None: "it is not known whether the log is complete",
}


@dataclass(frozen=True)
class Check:
    """A question, its answer, and whether the check passed; None if that is unknown."""

    question: str
    answer: str
    limit: str
    good: bool | None


def assess(checks: list[Check]) -> str:
    """Return an assessment of the run in one sentence."""
    failed = [check.question.lower() for check in checks if check.good is False]
    if not failed:
        return "The run passed all checks."
    if checks[0].good is False:
        return "The target was not acquired."
    return f"The run has findings: {', '.join(failed)}."


def headline(summary: Summary, totals: RunTotals) -> str:
    """Return the most important facts in one line: acquisition, losses, worst errors, completeness."""
    facts, modes = [], summary.modes
    if modes.first_tracking_s is None:
        facts.append("Never acquired")
    else:
        facts.append(f"Acquired after {modes.first_tracking_s:.2f} s")
        if modes.tracked_time_share is not None:
            facts.append(f"tracked {_percent(modes.tracked_time_share)} of the time")
            facts.append(f"at most {round(modes.longest_untracked_s or 0.0, 2):g} s without a track")
    if totals.worst_deg and totals.worst_m:
        facts.append(
            f"worst errors {totals.worst_deg.value:.2f}° (at {totals.worst_deg.time_s:.1f} s) "
            f"and {1e3 * totals.worst_m.value:.1f} mm (at {totals.worst_m.time_s:.1f} s)"
        )
    else:
        facts.append("errors not known")
    complete = summary.completeness.complete if summary.completeness else None
    facts.append(_COMPLETE[complete])
    return ", ".join(facts) + "."


def find_checks(summary: Summary, alarms: int) -> list[Check]:
    """Return the checks of a run; ``alarms`` is the number of errors that services reported."""
    return [
        *_estimation(summary),
        _dropped(summary),
        *_recorded(summary),
        Check("Services", f"{_count(alarms, 'error')} reported", "no error reported", alarms == 0),
    ]


def _estimation(summary: Summary) -> Iterator[Check]:
    modes, consistency = summary.modes, summary.consistency
    acquired = modes.first_tracking_s
    yield Check(
        "Acquisition",
        "never tracked" if acquired is None else f"tracking after {acquired:.2f} s",
        "tracked at some time",
        acquired is not None,
    )
    share = modes.tracking_share
    yield Check(
        "Tracking",
        "no frame tracked"
        if share is None
        else f"{_percent(share)} of frames, {_percent(modes.coasting_share or 0.0)} coasting, "
        f"{summary.estimates.lost_s:.1f} s lost",
        f"at least {_percent(MIN_TRACKING_SHARE)} of frames after the first acquisition",
        None if share is None else share >= MIN_TRACKING_SHARE,
    )
    off = modes.worse_than_10deg_or_0_3m_share
    yield Check(
        "Accuracy",
        "no estimate scored" if off is None else f"{_percent(off)} of frames off by more than 10° or 0.3 m",
        f"at most {_percent(MAX_OFF_TARGET_SHARE)}",
        None if off is None else off <= MAX_OFF_TARGET_SHARE,
    )
    yield from _truth(summary)
    within = consistency.nees_share_in_95 if consistency else None
    yield Check(
        "Covariance",
        "no estimate scored" if within is None else f"{_percent(within)} of errors within the 95 % bound",
        f"at least {_percent(MIN_NEES_SHARE)}",
        None if within is None else within >= MIN_NEES_SHARE,
    )


def _truth(summary: Summary) -> Iterator[Check]:
    """Yield the truth's own errors, if it states them. This check neither passes nor fails."""
    truth = summary.truth_error
    if truth is not None:
        yield Check(
            "Truth",
            f"its own error is {truth.attitude_deg_rms:.2g}° and {1e3 * truth.position_m_rms:.3g} mm (RMS): "
            f"it may be {_percent(truth.attitude_share)} of the mean squared attitude error and "
            f"{_percent(truth.position_share)} of the position's",
            "part of the covariance by which errors are checked",
            None,
        )


def dropped_share(summary: Summary) -> float:
    """Return the share of the frames that reached the estimator and were dropped."""
    dropped = summary.estimates.dropped
    processed = summary.estimates.accepted + summary.estimates.rejected
    return dropped / max(dropped + processed, 1)


def _dropped(summary: Summary) -> Check:
    share = dropped_share(summary)
    good = share <= MAX_DROPPED_SHARE
    remedy = "" if good else "; a busy or slow machine drops frames, a run with --speed max drops none"
    return Check(
        "Dropped frames",
        f"{_count(summary.estimates.dropped, 'frame')} dropped ({_percent(share)})",
        f"at most {_percent(MAX_DROPPED_SHARE)}{remedy}",
        good,
    )


def _recorded(summary: Summary) -> Iterator[Check]:
    missed = summary.missed
    yield Check("Log", f"{_count(missed, 'message')} missed", "no message missed", missed == 0)
    yield _readable(summary)
    stated = summary.completeness
    if stated is None or stated.complete is None:
        answer = "unknown: the log has no record of it"
    else:
        first = f"no: {stated.reasons[0]}" if stated.reasons else "no"
        more = f" and {_count(len(stated.reasons) - 1, 'other reason')}" if len(stated.reasons) > 1 else ""
        answer = "complete, by its own record" if stated.complete else first + more
    complete = stated.complete if stated else None
    yield Check("Completeness", answer, "the log's own record, checked against its content", complete)


def _readable(summary: Summary) -> Check:
    total = sum(count for reasons in summary.unreadable.values() for count in reasons.values())
    where = f" ({', '.join(sorted(summary.unreadable))})" if total else ""
    answer = f"{_count(total, 'message')} cannot be read{where}" if total else "every message can be read"
    return Check("Messages", answer, "every message readable", total == 0)


def _count(number: int, noun: str) -> str:
    return f"{number or 'no'} {noun}{'' if number == 1 else 's'}"


def _percent(share: float) -> str:
    return f"{100.0 * share:.4g} %"
