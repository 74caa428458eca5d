"""``rpod up`` with real processes: what dies or hangs comes back, and the end leaves nothing."""

import json
import signal
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path
from random import Random

import psutil
import pytest
import yaml
from facility_process import DEADLINE_S, Lines, until

from endurance.facility import SERVICES, kept_facility
from endurance.kills import desk
from rpod_runtime.session import free_endpoint


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


def test_each_service_is_killed_comes_back_tracks_again_and_the_logs_say_so(tmp_path):
    rnd = Random(1)
    with kept_facility(tmp_path, rate_hz=5.0) as facility, desk(facility) as at:
        assert at.settle() == ()
        for name in SERVICES:
            assert at.kill(name, rnd).wrong == ()
        asked = [sys.executable, "-m", "rpod", "ps", str(tmp_path / "hall.yaml"), "--json"]
        told = json.loads(subprocess.run(asked, capture_output=True, text=True, check=True).stdout)
        assert [each["restarts"] for each in told["services"]] == [1] * len(SERVICES)
        assert {each["last_end"] for each in told["services"]} == {"was killed by SIGKILL"}


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
    assert "a restart is needed for the changes of estimators" in log.read_text("utf-8")
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
