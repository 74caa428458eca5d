"""What the terminal says of a run beside its errors: unused frames, and messages that cannot be read."""

from io import StringIO

from rich.console import Console
from synthetic_log import SyntheticRun

from rpod.summary_table import print_summary
from rpod_analysis import open_log, stream_run
from rpod_analysis.scoring.summarise import summarise
from rpod_schemas.summary import InputAccount, LostFrames


def told(tmp_path, **changes):
    with open_log(SyntheticRun().write(tmp_path / "run.mcap")) as log:
        summary = summarise(log, stream_run(log)).model_copy(update=changes)
    console = Console(width=200, file=StringIO())
    with console.capture() as text:
        print_summary(summary, console)
    return text.get()


def test_a_sensor_with_many_unused_frames_has_a_row_with_the_last_reason(tmp_path):
    lost = {"rejected": LostFrames(frames=30, last="out of range: the target is predicted at 7.1 m")}
    few = {"rejected": LostFrames(frames=3, last="gate: nis 20")}
    text = told(tmp_path, inputs={"pmd": InputAccount(used=100, not_used=lost)})
    assert "pmd, rejected" in text
    assert "30 frames; the last one: out of range" in text
    assert "pmd, rejected" not in told(tmp_path, inputs={"pmd": InputAccount(used=100, not_used=few)})


def test_messages_that_cannot_be_read_are_counted(tmp_path):
    assert "cannot be read" not in told(tmp_path)
    assert "3 cannot be read" in told(tmp_path, unreadable={"pmd/info": {"late": 2, "malformed": 1}})


def test_a_run_that_dropped_many_frames_names_the_remedy(tmp_path):
    with open_log(SyntheticRun().write(tmp_path / "run.mcap")) as log:
        estimates = summarise(log, stream_run(log)).estimates
    used = estimates.accepted + estimates.rejected
    many, few = (estimates.model_copy(update={"dropped": round(share * used)}) for share in (1.0, 0.04))
    assert "50.0 % of the frames: this machine is busy or slow" in told(tmp_path, estimates=many)
    assert "--speed max" not in told(tmp_path, estimates=few)
