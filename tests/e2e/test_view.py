"""``rpod view`` and ``rpod run --view`` as processes."""

import signal
import subprocess
import sys

import psutil
import pytest
from command_line import called
from facility_process import until
from logger_desk import completeness
from logs import messages_of
from recordings import read_recording
from synthetic_log import SyntheticRun

from rpod_schemas.topics import STATUS

CHANNEL = f"/{STATUS.name}"

WITHOUT_RERUN = "import sys; sys.modules['rerun'] = None; from rpod.__main__ import main; main()"
PLAYED_WITHOUT_RERUN = f"""
import sys
sys.modules["rerun"] = None
import rpod_analysis.report
from rpod.errors import RunError
from rpod.play import command
def play(*_, view, **__):
    raise RunError(f"played, view is {{view}}")
command.play = play
{WITHOUT_RERUN}
"""


def rpod(*arguments, start=""):
    interpreter = ["-c", start] if start else ["-m", "rpod"]
    return subprocess.run(
        [sys.executable, *interpreter, *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=600.0,
        check=False,
    )


@pytest.fixture
def log(tmp_path):
    return SyntheticRun(duration_s=1.0, truth_rate_hz=50.0, target="mockup").write(tmp_path / "run.mcap")


def test_a_log_is_written_as_a_recording(log, tmp_path):
    ended = rpod("view", log, "--save", tmp_path / "run.rrd", "--from", 0.2)
    assert ended.returncode == 0, ended.stderr
    drawn = read_recording(tmp_path / "run.rrd")
    assert 7 <= len(drawn["image/pmd/depth"].stamps_ns) <= 9
    assert "chaser/truth/mesh" in drawn


@pytest.mark.parametrize(
    ("arguments", "code", "reason"),
    [
        (["nowhere.mcap"], 1, "nowhere.mcap"),
        (["--from", 2, "--to", 1], 2, "--to: is 1, not after --from 2"),
        (["--bind", "everywhere"], 2, "bind"),
        (["--save", "nowhere/run.rrd"], 1, "cannot write nowhere/run.rrd"),
        (["--target", "moon", "--save", "never.rrd"], 2, "moon"),
    ],
)
def test_what_cannot_be_shown_is_refused_in_one_line(log, arguments, code, reason):
    paths = [] if "nowhere.mcap" in arguments else [log]
    ended = called("view", *paths, *arguments)
    assert ended.returncode == code, ended.stderr
    assert reason in ended.stderr
    assert "Traceback" not in ended.stderr


def test_without_rerun_one_line_says_how_to_get_it(log):
    ended = rpod("view", log, start=WITHOUT_RERUN)
    assert ended.returncode == 1
    assert ended.stderr == "rpod: this verb needs rerun: pip install 'rpod[all]'\n"


def test_a_run_whose_view_is_killed_goes_on_and_leaves_nothing_of_it(start, monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    facility = start("envisat-station", "--duration", "600", "--view")
    facility.stderr.wait_for("view: shown in http://127.0.0.1:")
    facility.await_services()
    (view,) = [
        child for verb, child in facility.services.items() if child.cmdline()[1:4] == ["-m", "rpod", "view"]
    ]
    viewers = view.children(recursive=True)
    assert viewers
    view.send_signal(signal.SIGKILL)
    facility.stderr.wait_for("the run goes on without view: service view was killed by signal 9")
    logged = len(messages_of(facility.log, CHANNEL))
    until(lambda: len(messages_of(facility.log, CHANNEL)) >= logged + 2)
    facility.send(signal.SIGINT)
    assert facility.wait() == 130
    assert not facility.left()
    (reason,) = completeness(facility.log).reasons
    assert reason.startswith("view (session ")
    assert psutil.wait_procs(viewers, timeout=60.0)[1] == []


def test_a_run_without_rerun_goes_on_without_a_view(tmp_path):
    """What a run does from there on is what every run without a view does."""
    ended = rpod("run", "envisat-station", "--view", "--out", tmp_path, start=PLAYED_WITHOUT_RERUN)
    assert ended.returncode == 1
    no_view, played = ended.stderr.splitlines()
    assert no_view == "rpod run: no view, because it needs rerun-sdk: pip install 'rpod[view]'"
    assert played == "rpod run: played, view is False"
