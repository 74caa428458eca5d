"""``rpod up`` with real processes: what dies or hangs comes back, and the end leaves nothing."""

import json
import signal
import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path

import psutil
import pytest
import yaml
from facility_process import DEADLINE_S, Lines, until

from rpod_runtime.bus.session import free_endpoint

TARGET = {"target": "mockup"}
APPROACH = {"trajectory": {"kind": "approach", "start_m": [0, 0, 4.0], "end_m": [0, 0, 3.9]}}


class Facility:
    """A facility that ``rpod up`` keeps, with what its verbs say."""

    def __init__(self, folder, services, **fields):
        self.endpoint = free_endpoint()
        self.path = folder / "hall.yaml"
        document = {"name": "hall", "bus": {"connect": self.endpoint}, "services": services} | fields
        self.path.write_text(yaml.safe_dump(document, sort_keys=False), "utf-8")
        self.process = subprocess.Popen(
            [sys.executable, "-m", "rpod", "up", str(self.path)], stderr=subprocess.PIPE, text=True
        )
        self.said = Lines(self.process.stderr)
        self._status = folder / "hall.state" / "status.json"
        self.seen: set[psutil.Process] = set()

    def ask(self, verb):
        """Return exit code and answer of ``rpod ps`` or ``rpod down``."""
        done = subprocess.run(
            [sys.executable, "-m", "rpod", verb, str(self.path), "--json"],
            capture_output=True, text=True, timeout=DEADLINE_S, check=False,
        )  # fmt: skip
        return done.returncode, json.loads(done.stdout)

    def service(self, name, state="ready", restarts=0):
        """Wait until a service has a state after so many restarts; return what is told of it."""

        def found():
            if not self._status.exists():
                return None
            told = json.loads(self._status.read_text("utf-8"))["services"]
            (service,) = (each for each in told if each["name"] == name)
            return service if (service["state"], service["restarts"]) == (state, restarts) else None

        service = until(found)
        if service["pid"]:
            self.seen.add(psutil.Process(service["pid"]))
        return service

    def close(self):
        self.process.kill()
        self.process.wait()
        _, alive = psutil.wait_procs(self.seen, timeout=DEADLINE_S / 4)
        for process in alive:
            process.kill()
        assert not alive


@pytest.fixture
def up(tmp_path):
    with ExitStack() as stack:

        def start(services, **fields):
            facility = Facility(tmp_path, services, **fields)
            stack.callback(facility.close)
            return facility

        yield start


def test_a_motion_that_is_started_again_says_that_it_begins_anew_and_one_that_is_stopped_has_not_finished(up):
    facility = up(
        {
            "router": {"verb": "router"},
            "motion": {"verb": "motion", "config": TARGET | {"duration_s": 3600, "motion": APPROACH}},
        }
    )
    psutil.Process(facility.service("motion")["pid"]).kill()
    assert "from the beginning" in facility.service("motion", restarts=1)["message"]
    facility.process.send_signal(signal.SIGTERM)
    assert facility.process.wait(DEADLINE_S) == 0
    log = (facility.path.parent / "hall.state" / "logs" / "motion.log").read_text("utf-8")
    assert log.count("from the beginning: with epoch_ns a restart goes on") == 2
    assert "finished" not in log


def test_a_signal_that_comes_twice_at_once_as_from_timeout_stops_the_services_as_one_does(up):
    facility = up({"router": {"verb": "router"}})
    facility.service("router")
    for _ in range(2):
        facility.process.send_signal(signal.SIGTERM)
        time.sleep(0.05)  # else the kernel makes one of two
    assert facility.process.wait(DEADLINE_S) == 0
    log = (facility.path.parent / f"{facility.path.stem}.state" / "logs" / "router.log").read_text("utf-8")
    assert "was it killed?" not in log


def test_a_router_that_hangs_is_killed_and_started_again(up):
    facility = up({"router": {"verb": "router", "hang_s": 1.0}})
    router = psutil.Process(facility.service("router")["pid"])
    router.suspend()
    assert facility.service("router", restarts=1)["last_end"] == "hung for 1 s, was killed by SIGKILL"
    assert not router.is_running()


def test_at_a_sighup_the_log_level_changes_and_what_needs_a_restart_is_named(up):
    facility = up({"router": {"verb": "router"}})
    before = facility.service("router")
    document = yaml.safe_load(facility.path.read_text("utf-8"))
    document["services"]["router"]["config"] = {"log_level": "warning", "estimators": ["abc"]}
    facility.path.write_text(yaml.safe_dump(document, sort_keys=False), "utf-8")
    facility.process.send_signal(signal.SIGHUP)
    log = Path(before["log"])
    until(lambda: "log_level is warning" in log.read_text("utf-8"))
    assert "cannot change while it runs: estimators; restart the service" in log.read_text("utf-8")
    assert facility.service("router")["pid"] == before["pid"]


def test_down_stops_the_services_and_a_second_up_is_refused_while_one_runs(up):
    facility = up({"router": {"verb": "router"}})
    facility.service("router")
    with pytest.raises(subprocess.CalledProcessError) as refused:
        subprocess.run(
            [sys.executable, "-m", "rpod", "up", str(facility.path)], capture_output=True, check=True
        )
    assert refused.value.returncode == 1
    assert b"the facility is up already" in refused.value.stderr
    assert facility.ask("down") == (0, {"name": "hall", "up": False, "pid": None, "services": []})
    assert facility.process.wait(DEADLINE_S) == 0
    assert facility.ask("ps")[0] == 1


def test_a_service_that_cannot_work_waits_longer_each_time_and_a_refused_one_is_left(up):
    elsewhere = {"listen": "tcp/192.0.2.1:7447"}  # RFC 5737: no machine has it
    facility = up(
        {
            "router": {"verb": "router", "config": elsewhere},
            "estimator": {"verb": "estimator", "config": {"target": "none", "sensors": [{"kind": "pmd"}]}},
        },
        backoff={"first_s": 0.05, "max_s": 0.1},
    )
    facility.said.wait_for(r"router: ended with exit code 1; to be started again in 0.05 s")
    facility.said.wait_for(r"router: ended with exit code 1; to be started again in 0.1 s")
    facility.said.wait_for(r"estimator: its configuration is refused; correct it: .*none")
    assert facility.service("estimator", "refused")["restarts"] == 0
    assert facility.ask("ps")[0] == 1


def test_a_logger_that_cannot_write_is_failing_and_says_why_and_what_to_do(up, tmp_path):
    folder = tmp_path / "logs"
    folder.touch()
    facility = up(
        {"router": {"verb": "router"}, "logger": {"verb": "logger", "config": {"directory": str(folder)}}}
    )
    failing = facility.service("logger", "failing")
    assert f"cannot write {folder}/rpod-" in failing["message"]
    assert (
        "File exists; a file is in the place of a folder: move it away, or set another directory"
        in failing["message"]
    )
    facility.said.wait_for(r"logger: cannot write .*set another directory")
    assert facility.ask("ps")[0] == 1
    folder.unlink()
    at_work = facility.service("logger")
    assert at_work["message"].startswith(f"recording to {folder}/rpod-")
    assert at_work["pid"] == failing["pid"]
    (log,) = folder.glob("*.mcap")
    log.unlink()
    assert "the file has vanished from its directory" in facility.service("logger", "failing")["message"]
    assert facility.ask("ps")[0] == 1
