"""Fuzzes readers in this process, and the facility over the bus: ``make fuzz``.

    PYTHONPATH=tests python -m fuzz [MINUTES] [SEED]

Of more than 5 minutes 57 % go to the bus, and 10 % to inputs that coverage guides: an hour makes a million
messages on the bus, and ten million inputs for readers. What fails is written to ``tests/fuzz/found``, where
a test reads it from then on.
"""

import resource
import sys
import time
import traceback
import warnings
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from random import Random

from fuzz.cases import Case
from fuzz.guided import fuzz_guided
from fuzz.over_bus import fuzz_facility
from fuzz.subjects import Subject, subjects

SLOW_S = 5.0
"""Processor time of one input above which it is a failure."""
LARGE_MIB = 500.0
"""Growth of the most memory by one input above which it is a failure."""
_SLICE_S = 1.0
_BUS_SHARE, _GUIDED_SHARE, _LEAST_FOR_BOTH_MIN = 0.57, 0.1, 5.0


@dataclass
class Outcomes:
    """What came of the inputs of one subject."""

    inputs: int = 0
    accepted: int = 0
    cpu_s: float = 0.0
    failures: Counter[str] = field(default_factory=Counter)


def main(minutes: float, seed: int) -> int:
    """Fuzz for so long; return how many kinds of failures there are."""
    warnings.simplefilter("ignore")
    guided, on_bus = (_GUIDED_SHARE, _BUS_SHARE) if minutes > _LEAST_FOR_BOTH_MIN else (0.0, 0.0)
    by_name = {name: Outcomes() for name in subjects()}
    until_s, memory_mib = time.monotonic() + 60.0 * minutes * (1.0 - guided - on_bus), _memory_mib()
    round_number = 0
    while time.monotonic() < until_s:
        for name, subject in subjects().items():
            _fuzz(subject, by_name[name], Random(f"{seed}/{name}/{round_number}"), until_s)
        round_number += 1
        if round_number == 1:
            memory_mib = _memory_mib()
    for name, outcomes in by_name.items():
        counts = f"{outcomes.inputs:9} inputs, {outcomes.accepted:9} accepted, {outcomes.cpu_s:7.1f} s"
        print(f"{name:45} {counts}, {len(outcomes.failures)} kinds of failures")
    failures = sum((outcomes.failures for outcomes in by_name.values()), Counter[str]())
    inputs = sum(outcomes.inputs for outcomes in by_name.values())
    memory = f"{memory_mib:.0f} MiB after the first round, {_memory_mib():.0f} at the end"
    print(f"{inputs} inputs with seed {seed}; most memory {memory}", flush=True)
    if guided:
        failures += fuzz_guided(60.0 * minutes * guided, seed)
    if on_bus:
        failures += fuzz_facility(60.0 * minutes * on_bus, seed)
    for text, count in failures.most_common():
        print(f"{count:6} x {text}")
    return min(len(failures), 1)


def _fuzz(subject: Subject, outcomes: Outcomes, rnd: Random, until_s: float) -> None:
    begin_s = time.process_time()
    while (now_s := time.process_time()) - begin_s < _SLICE_S and time.monotonic() < until_s:
        take(subject, outcomes, subject.make(rnd))
    outcomes.cpu_s += now_s - begin_s


def take(subject: Subject, outcomes: Outcomes, data: bytes) -> None:
    """Have one input read, and note what came of it."""
    failure, read_s, memory_mib = "", time.process_time(), _memory_mib()
    try:
        outcomes.accepted += subject.read(data)
    except Exception as error:  # noqa: BLE001 - every kind is a finding
        failure = f"{subject.name}: {_kind(error)}"
    if time.process_time() - read_s > SLOW_S:
        failure = f"{subject.name}: took more than {SLOW_S:g} s"
    if _memory_mib() - memory_mib > LARGE_MIB:
        failure = f"{subject.name}: took more than {LARGE_MIB:g} MiB"
    outcomes.inputs += 1
    if failure:
        if failure not in outcomes.failures:
            Case(subject.name, data).write()
        outcomes.failures[failure] += 1


def _kind(error: Exception) -> str:
    """Return class, text and place of an error, without what differs from one to the next of its kind."""
    ours = [frame for frame in traceback.extract_tb(error.__traceback__) if "rpod_" in frame.filename]
    last = ours[-1] if ours else traceback.extract_tb(error.__traceback__)[-1]
    return f"{type(error).__name__} at {Path(last.filename).name}:{last.lineno}"


def _memory_mib() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


if __name__ == "__main__":
    sys.exit(main(float((sys.argv[1:] or ["10"])[0]), int((sys.argv[2:] or ["0"])[0])))
