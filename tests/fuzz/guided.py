"""Hostile input that is steered by the lines it reaches: Atheris (libFuzzer), where it is installed.

    PYTHONPATH=tests python -m fuzz.guided SECONDS [SEED]

``make fuzz`` runs it as a process, since libFuzzer ends its process itself. An input begins with the number
of its subject. What fails is written as a case, as in the other parts, and its line is printed.
"""

import re
import subprocess
import sys
from collections import Counter
from importlib.util import find_spec
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory

from fuzz.cases import Case

PACKAGES = (
    "rpod_schemas.messages", "rpod_schemas.rmw", "rpod_schemas.config", "rpod_schemas.types", "rpod_runtime",
    "rpod_analysis", "rpod_target.mesh",
)  # fmt: skip
"""What is instrumented: readers, but no module that is compiled."""
_LONGEST_INPUT = 65_536
_END_S = 120.0
_RUNS = re.compile(r"number_of_executed_units: (\d+)")
_FAILURE = "failure: "
_SLOW = ("log", "configuration", "target")
"""In the names of subjects of which one input takes 10 ms or more."""


def fuzz_guided(budget_s: float, seed: int) -> Counter[str]:
    """Fuzz for so long in a process of its own; return what was found."""
    if find_spec("atheris") is None:
        print("guided by coverage: left out, since Atheris is not installed (pip install --group fuzz)")
        return Counter()
    with TemporaryDirectory() as folder:
        command = (sys.executable, "-m", "fuzz.guided", f"{budget_s:.0f}", str(seed), folder)
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=budget_s + _END_S)
        artifacts = [file.read_bytes() for file in Path(folder).glob("*-*")]
    found = Counter(
        line.removeprefix(_FAILURE) for line in done.stdout.splitlines() if line.startswith(_FAILURE)
    )
    for data in artifacts:  # what ended the process, or took too long
        name = _names()[data[0] % len(_names())]
        Case(name, data[1:]).write()
        found[f"{name}: ended the process, or took too long"] += 1
    runs = _RUNS.search(done.stderr)
    if done.returncode and not artifacts:
        found[f"guided by coverage: exit code {done.returncode}: {done.stderr[-300:]}"] += 1
    print(f"guided by coverage: {runs[1] if runs else 'an unknown number of'} inputs")
    return found


def _names() -> list[str]:
    from fuzz.subjects import subjects  # noqa: PLC0415 - imported again in the process, instrumented

    return [name for name in subjects() if not any(word in name for word in _SLOW)]


def _main(budget_s: int, seed: int, folder: str) -> None:
    import atheris  # noqa: PLC0415 - optional

    with atheris.instrument_imports(include=list(PACKAGES)):
        from fuzz.subjects import subjects  # noqa: PLC0415
    from fuzz.__main__ import Outcomes, take  # noqa: PLC0415
    from fuzz.mutation import mutate_bytes  # noqa: PLC0415

    names, outcomes = _names(), Outcomes()

    def read(data: bytes) -> None:
        if not data:
            return
        subject, told = subjects()[names[data[0] % len(names)]], set(outcomes.failures)
        take(subject, outcomes, data[1:])
        for failure in set(outcomes.failures) - told:
            print(_FAILURE + failure, flush=True)

    def changed(data: bytes, longest: int, number: int) -> bytes:
        rnd = Random(number)
        kind = rnd.randrange(4)
        if kind == 0 or len(data) < 2:
            place = rnd.randrange(len(names))
            return bytes((place,)) + subjects()[names[place]].make(rnd)[: longest - 1]
        if kind == 1:
            return data[:1] + mutate_bytes(rnd, data[1:])[: longest - 1]
        return data[:1] + bytes(atheris.Mutate(data[1:], longest - 1))

    options = (
        f"-max_total_time={budget_s}", f"-seed={seed + 1}", f"-max_len={_LONGEST_INPUT}", "-timeout=20",
        "-rss_limit_mb=4096", "-len_control=0", "-verbosity=0", "-print_final_stats=1",
        f"-artifact_prefix={folder}/",
    )  # fmt: skip
    atheris.Setup([sys.argv[0], *options], read, custom_mutator=changed)
    atheris.Fuzz()


if __name__ == "__main__":
    _main(int(sys.argv[1]), int((sys.argv[2:] or ["0"])[0]), (sys.argv[3:] or ["."])[0])
