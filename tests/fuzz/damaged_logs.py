"""Reports of a number of damaged logs, in this process: each gives a report or one line, never a traceback.

    PYTHONPATH=tests python -m fuzz.damaged_logs [COUNT] [SEED]

What fails is written to ``tests/fuzz/found``, where a test reads it from then on.
"""

import sys
import time
import warnings
from random import Random

from fuzz.__main__ import Outcomes, take
from fuzz.subjects import subjects

_STEP = 500


def main(count: int, seed: int) -> int:
    """Read so many damaged logs; return whether one failed."""
    warnings.simplefilter("ignore")
    kinds = [subject for name, subject in subjects().items() if name.startswith("report of a log")]
    by_name = {subject.name: Outcomes() for subject in kinds}
    begin_s = time.process_time()
    for number in range(count):
        subject = kinds[number % len(kinds)]
        take(subject, by_name[subject.name], Random(f"{seed}/{subject.name}/{number}"))
        if (number + 1) % _STEP == 0 or number + 1 == count:
            failed = sum(sum(outcomes.failures.values()) for outcomes in by_name.values())
            spent_s = time.process_time() - begin_s
            print(f"{number + 1:6} logs, {failed} failed, {spent_s:.0f} s of processor time", flush=True)
    for name, outcomes in by_name.items():
        print(f"{name:40} {outcomes.inputs:6} logs, {outcomes.accepted:6} reports, {dict(outcomes.failures)}")
    return int(any(outcomes.failures for outcomes in by_name.values()))


if __name__ == "__main__":
    sys.exit(main(int((sys.argv[1:] or ["10000"])[0]), int((sys.argv[2:] or ["0"])[0])))
