"""What a person sees while a verb works."""

import io

import pytest
from rich.console import Console

from rpod.play.progress import Progress
from rpod.scenarios import find
from rpod.steps import Steps
from rpod_schemas.types import Diagnostic, Health


class FakeNode:
    def subscribe(self, topic, sink):
        pass


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
