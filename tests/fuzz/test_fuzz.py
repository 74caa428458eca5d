"""Hostile input of every kind is read or refused: a few of each here, hours by ``make fuzz``."""

from random import Random

import pytest
from fuzz.cases import CASES, Case
from fuzz.subjects import subjects
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

SLOW = "log"
"""In the names of subjects of which one input takes a tenth of a second."""

pytestmark = pytest.mark.filterwarnings("ignore")  # of NumPy, about numbers that it was made to see


@pytest.mark.parametrize("name", subjects())
def test_hostile_input_is_read_or_refused(name):
    subject = subjects()[name]

    @settings(
        max_examples=5 if SLOW in name else 40,
        phases=(Phase.generate,) if SLOW in name else (Phase.generate, Phase.shrink),
        derandomize=True,
        database=None,
        suppress_health_check=(
            HealthCheck.too_slow,
            HealthCheck.data_too_large,
            HealthCheck.large_base_example,
        ),
    )
    @given(st.randoms(use_true_random=False))
    def reads(rnd: Random) -> None:
        subject.read(subject.make(rnd))

    reads()


@pytest.mark.parametrize("path", sorted(CASES.glob("*.json")), ids=lambda path: path.stem)
def test_what_once_failed_is_read_or_refused(path):
    case = Case.read(path)
    subjects()[case.subject].read(case.data)


def test_both_good_and_hostile_input_is_made():
    for name, subject in subjects().items():
        if SLOW in name or name.startswith(("message", "configuration", "target")):
            continue
        outcomes = {subject.read(subject.make(Random(number))) for number in range(300)}
        assert outcomes == {True, False}, name
