"""What a person sees while a verb works."""

import io

import pytest
from rich.console import Console

from rpod.play.progress import Progress
from rpod.scenarios import find
from rpod.steps import Steps
from rpod_runtime import Received
from rpod_schemas.messages import write_diagnostics, write_transforms
from rpod_schemas.poses import make_pose
from rpod_schemas.rmw.cdr import encode
from rpod_schemas.rmw.wire import Attachment
from rpod_schemas.topics import DIAGNOSTICS, TARGET, TARGET_ESTIMATE, TF
from rpod_schemas.types import Diagnostic, Health


class FakeNode:
    def subscribe(self, topic, sink):
        pass


def test_what_is_not_shown_need_not_be_watched():
    assert not Progress(quiet=True).is_shown
    assert Progress(quiet=False).is_shown


@pytest.mark.parametrize(
    ("lockstep", "words"), [(False, "pmd 3.0 Hz"), (True, "pmd 3.0 frames a second of real time")]
)
def test_a_rate_in_lockstep_is_said_to_be_of_real_time(lockstep, words):
    progress = Progress(quiet=True)
    progress.watch(FakeNode(), find("mockup-oblique"), lockstep=lockstep)
    for second, count in ((1, 10), (2, 13)):
        values = {"frames/pmd": str(count)}
        told = Diagnostic(
            stamp_ns=second * 10**9, name="emulator", level=Health.OK, message="", values=values
        )
        progress._take_counters(told.stamp_ns, told.values)
    assert progress._cells()[1].plain == words


def transform(stamp_ns, child):
    message = write_transforms(stamp_ns, [("chaser", child, make_pose(translation_m=(0.0, 0.0, 4.0)))])
    return Received(TF, "k", memoryview(bytes(encode(message))), Attachment(1, 0, bytes(16)), 0)


def test_two_truths_of_one_stamp_do_not_end_the_run_that_is_watched():
    progress = Progress(quiet=True)
    progress.watch(FakeNode(), find("mockup-oblique"))
    for child in (TARGET, TARGET, TARGET_ESTIMATE):
        progress._take(transform(10**9, child))
    assert progress._error() == "error 0.00 deg  0 mm"


def test_diagnostics_of_strangers_fill_neither_the_memory_nor_write_on_the_terminal():
    progress = Progress(quiet=True)
    for number in range(500):
        told = Diagnostic(
            stamp_ns=number,
            name=f"liar{number}",
            level=Health.WARN,
            message="fine\x1b[2J\nERROR logger: lost",
            values={f"frames/s{number}": "1"},
        )
        message = encode(write_diagnostics([told]))
        received = Received(DIAGNOSTICS, "k", memoryview(bytes(message)), Attachment(1, 0, bytes(16)), 0)
        progress._take(received)
    problems = progress._problems()
    assert len(problems) == len(progress._seen.counted) == 100
    assert problems[0].plain == "WARN liar0: fine�[2J�ERROR logger: lost"


@pytest.mark.parametrize(("terminal", "quiet"), [(False, False), (True, False), (False, True)])
def test_steps_are_said_on_standard_error(terminal, quiet, monkeypatch):
    said = io.StringIO()
    monkeypatch.setattr(
        "rpod.steps.Console",
        lambda **options: Console(file=said, force_terminal=terminal, quiet=options["quiet"], width=100),
    )
    with Steps(quiet=quiet) as steps:
        steps.say("reading sat.stl")
        steps.say("building the target")
    assert ("building the target ..." in said.getvalue()) != quiet
    assert ("reading sat.stl ..." in said.getvalue()) == (not quiet and not terminal)  # else it is redrawn
