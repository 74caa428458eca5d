"""Lines about delivery: publishers, rate, gaps, parts of frames, and the bus."""

from collections import Counter, defaultdict
from itertools import pairwise

import numpy as np

from rpod_driver.check.observations import Heard, Observations
from rpod_driver.check.result import CheckResult, fail, note, ok, unchecked
from rpod_schemas.messages import NANOSECONDS
from rpod_schemas.sensors import sensor_kind
from rpod_schemas.topics import DIAGNOSTICS, PARAMETER_EVENTS, ROSOUT, TF_STATIC
from rpod_schemas.types import Health

LEAST_FRAMES = 8
"""Least number of frames for the checks of the times between them."""
_MISSING_SHARE = 0.01
"""Share of missing frames up to which there is no fault: one in a hundred does not affect a track."""
_STALL_S, _STALL_PERIODS = 0.5, 8.0
"""Length above which a gap is a stall, s, and in periods; an estimate stays valid for only 0.2 s."""
_RATE_SHARE = 0.9
_LOST_SHARE = 0.005
_WAIT_S, _WAIT_PERIODS = 0.1, 2.0
"""Time that nineteen of twenty messages may wait longer than the fastest one, s, and in periods."""
_UNPAIRED_SHARE = 0.05
_OF_EACH_NODE = {DIAGNOSTICS.name, ROSOUT.name, PARAMETER_EVENTS.name, TF_STATIC.name}
"""Topics that any node publishes."""
_MOST_NAMED = 8


def publisher(seen: Observations) -> CheckResult:
    """Check whether one publisher sends the frames."""
    line = "publisher"
    peers: dict[str, dict[object, list[int]]] = defaultdict(lambda: defaultdict(list))
    for heard in seen.heard:
        peers[heard.part][heard.peer].append(heard.arrival_ns)
    if seen.leading not in peers:
        others = f", only {', '.join(sorted(peers))}" if peers else ""
        return fail(
            line, f"no {seen.leading} of {seen.name!r} came{others}; {_published_instead(seen)}", "silence"
        )
    for part, times in peers.items():
        spans = sorted((min(ns), max(ns)) for ns in times.values())
        if any(later[0] < earlier[1] for earlier, later in pairwise(spans)):
            names = " and ".join(map(str, times))
            return fail(line, f"{len(times)} publishers of {part} at once: {names}", "second_publisher")
    several = max(len(times) for times in peers.values())
    if several > 1:
        return note(line, f"{several} publishers one after another: the driver was started again")
    return ok(line, str(next(iter(peers[seen.leading]))))


def _published_instead(seen: Observations) -> str:
    """Return which publishers there are if no frame came: a name may be wrong, or the sensor silent."""
    topics = sensor_kind(seen.kind).part_topics(seen.name, seen.options.source)
    wanted = topics[seen.leading].name
    if wanted in seen.qos:
        troubles = [each for each in seen.diagnostics.values() if each.level is Health.ERROR]
        said = "".join(f"; {each.name} says: {each.message}" for each in troubles[:_MOST_NAMED])
        return f"{wanted} has a publisher, which sends nothing{said}"
    rest = sorted(set(seen.qos) - _OF_EACH_NODE)
    if not rest:
        return "no sensor is on this bus"
    more = f" and {len(rest) - _MOST_NAMED} more" if len(rest) > _MOST_NAMED else ""
    named = ", ".join(rest[:_MOST_NAMED])
    return f"nobody publishes {wanted}; published are {named}{more}: compare name, kind and --source"


def few(seen: Observations) -> str:
    """Return why times cannot be checked; empty if they can."""
    count = len(seen.leads)
    return (
        "" if count >= LEAST_FRAMES else f"{count} frames came, {LEAST_FRAMES} are needed; watch for longer"
    )


def rate(seen: Observations) -> CheckResult:
    """Check the rate against the nominal one."""
    line = "rate"
    if reason := few(seen):
        return unchecked(line, reason)
    leads = seen.leads
    span_s = (leads[-1].arrival_ns - leads[0].arrival_ns) / NANOSECONDS
    rate_hz = (len(leads) - 1) / span_s if span_s > 0 else float("inf")
    nominal_hz = seen.options.rate_hz
    if nominal_hz is None:
        return unchecked(line, f"{rate_hz:.2f} Hz; give the nominal rate with --rate", rate_hz=rate_hz)
    text = f"{rate_hz:.2f} Hz of {nominal_hz:g} Hz"
    if rate_hz < _RATE_SHARE * nominal_hz:
        return fail(line, text, "slow_rate", rate_hz=rate_hz)
    return ok(line, text, rate_hz=rate_hz)


def _missing(leads: list[Heard], period_ns: float) -> list[int]:
    """Return how many frames each gap lacks that the bus did not lose."""
    missing = []
    for earlier, later in pairwise(leads):
        lost = later.sequence - earlier.sequence - 1
        absent = round((later.stamp_ns - earlier.stamp_ns) / period_ns) - 1 - max(lost, 0)
        if absent > 0:
            missing.append(absent)
    return missing


def gaps(seen: Observations) -> CheckResult:
    """Check whether frames are missing between those that were published."""
    line = "gaps"
    if reason := few(seen):
        return unchecked(line, reason)
    period_s = seen.period_s
    if not np.isfinite(period_s):
        return unchecked(line, "stamps do not rise")
    missing = _missing(seen.leads, period_s * NANOSECONDS)
    total, longest = sum(missing), max(missing, default=0)
    share = total / (total + len(seen.leads))
    longest_s = longest * period_s
    text = f"{total} of {total + len(seen.leads)} frames missing, the longest gap {longest_s:.2f} s"
    figures = {"missing_share": share, "longest_gap_s": longest_s}
    if longest_s > max(_STALL_S, _STALL_PERIODS * period_s):
        return fail(line, text, "stall", "lost_frames", **figures)
    if total >= 2 and share > _MISSING_SHARE:
        return fail(line, text, "lost_frames", **figures)
    return ok(line, text, **figures)


def bus(seen: Observations) -> CheckResult:
    """Check losses and waits between publisher and receiver, and state the bandwidth."""
    line = "bus"
    if reason := few(seen):
        return unchecked(line, reason)
    lost, received, waits_s = 0, 0, []
    for part in {heard.part for heard in seen.heard}:
        messages = seen.of_part(part)
        received += len(messages)
        lost += sum(max(later.sequence - earlier.sequence - 1, 0) for earlier, later in pairwise(messages))
        if all(heard.sent_ns for heard in messages):
            times_s = np.array([heard.arrival_ns - heard.sent_ns for heard in messages]) / NANOSECONDS
            waits_s.append(float(np.quantile(times_s, 0.95) - times_s.min()))
    span_s = max((seen.ended_ns - seen.started_ns) / NANOSECONDS, 1e-3)
    rate_MB_s = sum(heard.size for heard in seen.heard) / span_s / 1e6
    wait_s = max(waits_s, default=0.0)
    share = lost / (lost + received)
    text = (
        f"{rate_MB_s:.2f} MB/s, {lost} of {lost + received} messages lost, "
        f"95 % wait {1e3 * wait_s:.0f} ms at most"
    )
    figures = {"megabytes_per_s": rate_MB_s, "lost_share": share, "wait_s": wait_s}
    period_s = seen.period_s if np.isfinite(seen.period_s) else 0.0
    faults = [
        *(["lost_messages"] if share > _LOST_SHARE else []),
        *(["slow_link"] if wait_s > max(_WAIT_S, _WAIT_PERIODS * period_s) else []),
    ]
    return fail(line, text, *faults, **figures) if faults else ok(line, text, **figures)


def parts(seen: Observations) -> CheckResult:
    """Check whether the parts of a frame come, under one stamp."""
    line = "parts"
    if reason := few(seen):
        return unchecked(line, reason)
    kind = sensor_kind(seen.kind)
    topics = kind.part_topics(seen.name, seen.options.source)
    counts = Counter(heard.part for heard in seen.heard)
    absent = [name for name in topics if not counts[name]]
    needed = [name for name in absent if name not in kind.optional]
    if needed:
        return fail(line, f"{' and '.join(needed)} does not come at all", "missing_part")
    for name in (name for name in topics if counts[name] and name != seen.leading):
        share, step_ns = _unpaired(seen, name)
        if share > _UNPAIRED_SHARE and step_ns and counts[name] >= 0.5 * counts[seen.leading]:
            when = "later" if step_ns > 0 else "earlier"
            text = f"{name} is stamped {abs(step_ns) * 1e-6:.3f} ms {when} than {seen.leading}"
            return fail(line, text, "unpaired_parts", unpaired_share=share)
    text = ", ".join(f"{counts[name]} {name}" for name in topics)
    return ok(line, text) if not absent else note(line, f"{text}; {', '.join(absent)} is optional")


def _unpaired(seen: Observations, name: str) -> tuple[float, int]:
    """Return the share of frames without a part of this name at their stamp, and where the part is, ns."""
    stamps_ns = np.sort([heard.stamp_ns for heard in seen.of_part(name)])
    leads_ns = np.array([heard.stamp_ns for heard in seen.leads])
    places = np.searchsorted(stamps_ns, leads_ns).clip(1, max(len(stamps_ns) - 1, 1))
    around = np.stack([stamps_ns[places - 1], stamps_ns[np.minimum(places, len(stamps_ns) - 1)]])
    steps_ns = around - leads_ns
    steps_ns = steps_ns[np.abs(steps_ns).argmin(axis=0), np.arange(len(leads_ns))]
    apart = np.abs(steps_ns) > seen.options.source.pair_within_s * NANOSECONDS
    period_ns = seen.period_s * NANOSECONDS
    near = apart & (np.abs(steps_ns) < 0.5 * period_ns)
    if not near.any():
        return float(apart.mean()), 0
    return float(near.mean()), int(np.median(steps_ns[near]))
