"""Faults of processes, links and the disk at their times; supervisor and bus only take notes."""

import signal
from dataclasses import replace
from pathlib import Path

import pytest
from pydantic import ValidationError

from rpod.play.command import ends_early, run_command
from rpod.play.facility import configure
from rpod.play.fault_player import FaultPlayer
from rpod.play.secure_run import ROLES, secured
from rpod.scenarios import find
from rpod_runtime.errors import RefusedError
from rpod_schemas.config.pmd.reduced_rate import ReducedRateConfig
from rpod_schemas.config.scenario import Scenario
from rpod_schemas.control import FaultRequest
from rpod_schemas.errors import ConfigurationError
from rpod_schemas.faults.injected import read_faults
from rpod_security.authority import Authority
from rpod_security.errors import CredentialsError

SECOND_NS = 1_000_000_000
EPOCH_NS = 100 * SECOND_NS


class Notes:
    """A supervisor and a node."""

    def __init__(self) -> None:
        self.done, self.told, self.serves = [], [], {}

    def kill(self, verb) -> None:
        self.done.append(("kill", verb))

    def restart(self, verb) -> None:
        self.done.append(("restart", verb))

    def signal(self, verb, number) -> None:
        self.done.append((number.name, verb))

    def ask(self, instance, verb, _reply, request=None, **_):
        self.done.append((verb, instance, getattr(request, "fault", "")))

    def serve(self, verb, _model, handler) -> None:
        self.serves[verb] = handler

    def publisher(self, _topic):
        return self

    def publish(self, message) -> None:
        self.told.append(read_faults(message)[-1])


def scenario(*faults):
    return Scenario.model_validate(dict(find("mockup-tumbling")) | {"faults": faults})


def played(*faults, until_s):
    notes, run = Notes(), scenario(*faults)
    player = FaultPlayer(notes, notes, run)
    for fault in run.faults:
        begin_ns = EPOCH_NS + round(fault.start_s * SECOND_NS)
        player._add(fault, begin_ns, begin_ns + round(fault.duration_s * SECOND_NS))
    for tenth in range(round(10 * until_s)):
        player._turn(EPOCH_NS + tenth * SECOND_NS // 10)
    return notes


def test_a_service_is_stopped_and_goes_on_and_the_bus_is_told():
    notes = played({"fault": "stop", "service": "estimator", "start_s": 1, "duration_s": 2}, until_s=4)
    assert notes.done == [("SIGSTOP", "estimator"), ("SIGCONT", "estimator")]
    (told,) = notes.told
    assert (told.fault, told.where) == ("stop", "estimator")
    assert (told.begin_ns - EPOCH_NS, told.end_ns - EPOCH_NS) == (SECOND_NS, 3 * SECOND_NS)


def test_a_killed_estimator_comes_back():
    notes = played({"fault": "kill", "service": "estimator", "start_s": 1, "duration_s": 1}, until_s=4)
    assert notes.done == [("kill", "estimator"), ("restart", "estimator")]


def test_faults_of_links_and_of_the_disk_are_asked_of_proxy_and_logger():
    link = {"fault": "link_stall", "service": "logger", "start_s": 1, "duration_s": 1}
    notes = played(link, {"fault": "disk_full", "start_s": 2, "duration_s": 1}, until_s=4)
    assert notes.done == [
        ("fault", "proxy", "link_stall"),
        ("fault", "logger", "disk_full"),
        ("start", "logger", ""),
    ]
    assert notes.told == []  # both tell it themselves


def test_a_slow_service_stands_still_for_its_share_of_each_period():
    notes, run = Notes(), scenario({"fault": "slow", "service": "logger", "size": 0.5, "duration_s": 1})
    player = FaultPlayer(notes, notes, run)
    player._add(run.faults[0], EPOCH_NS, EPOCH_NS + SECOND_NS)
    for hundredth in range(110):
        player._turn(EPOCH_NS + hundredth * SECOND_NS // 100)
    signals = [name for name, _ in notes.done]
    assert signals[:-1] == ["SIGSTOP", "SIGCONT"] * 10
    assert signals[-1] == signal.SIGCONT.name


def test_a_request_of_another_kind_is_refused_with_who_serves_it():
    notes = played(until_s=0)
    with pytest.raises(RefusedError, match="rpod/emulator/fault"):
        notes.serves["fault"](FaultRequest(fault="dropout", duration_s=1.0))
    with pytest.raises(RefusedError, match="motion cannot be killed"):
        notes.serves["fault"](FaultRequest(fault="kill", service="motion", duration_s=1.0))


def test_only_links_with_faults_pass_through_the_proxy_and_lockstep_has_none():
    run = scenario({"fault": "link_delay", "service": "estimator", "duration_s": 1}, {"fault": "glints"})
    facility = configure(run, directory=Path(), speed="1")
    assert set(facility.proxy.links) == {"estimator"}
    through = facility.services["estimator"].bus.connect
    assert through == f"tcp/{facility.proxy.links['estimator'].listen}"
    assert {facility.services[verb].bus.connect for verb in ("motion", "emulator", "logger")} == {
        facility.router.listen
    }
    assert [fault.fault for fault in facility.services["emulator"].faults] == ["glints"]
    with pytest.raises(ConfigurationError, match="link_delay needs the wall clock"):
        configure(run, directory=Path(), speed="max")
    assert configure(find("mockup-tumbling"), directory=Path(), speed="1").proxy is None


def test_on_a_secure_bus_a_faulty_link_passes_through_the_proxy_encrypted_and_the_proxy_has_a_certificate(
    tmp_path,
):
    authority = Authority.create(tmp_path)
    authority.issue("router", "router", hosts=("127.0.0.1",))
    for name, role in ROLES.items():
        if name != "proxy":
            authority.issue(role, name)
    run = scenario({"fault": "link_delay", "service": "estimator", "duration_s": 1})
    plain, rules = configure(run, directory=Path(), speed="1"), tmp_path / "run" / "rules.json"
    with pytest.raises(CredentialsError, match=r"proxy: identity\.pem is missing; run 'rpod pki init'"):
        secured(plain, tmp_path, rules=rules)
    authority.issue("proxy", "proxy")
    facility = secured(plain, tmp_path, rules=rules)
    through = facility.proxy.links["estimator"]
    assert facility.services["estimator"].bus.connect == f"tls/{through.listen}"
    assert f"tls/{through.target}" == facility.router.listen == facility.proxy.bus.connect
    assert facility.services["logger"].bus.connect == facility.router.listen
    assert facility.proxy.bus.credentials == tmp_path / "proxy"
    assert "proxy" in rules.read_text("utf-8")


def test_a_run_in_lockstep_with_a_fault_of_a_process_is_refused_in_one_line(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("rpod.play.command.configure_logging", lambda _: None)
    asked = {"fault": "stop", "service": "estimator", "start_s": 1.0, "duration_s": 1.0}
    file = tmp_path / "lockstep.json"
    file.write_text(scenario(asked).model_dump_json(), "utf-8")
    options = dict.fromkeys(("duration_s", "seed", "pki"))
    code = run_command(str(file), speed="max", out=tmp_path, view=False, as_json=True, **options)
    assert code == 2
    assert "stop needs the wall clock: run it with --speed 1" in capsys.readouterr().err


def test_a_fault_of_a_service_that_a_run_does_not_have_is_refused():
    with pytest.raises(ValidationError, match="link_delay of 'router', needs one of motion"):
        scenario({"fault": "link_delay", "service": "router", "duration_s": 1})


def test_a_slow_link_is_set_on_both_sides_and_a_stream_of_reduced_rate_is_recorded():
    document = dict(find("mockup-tumbling"))
    camera = document["sensors"][0].model_copy(update={"reduced_rate": ReducedRateConfig(mbit_s=8)})
    run = Scenario.model_validate(document | {"link": "slow", "sensors": (camera,)})
    facility = configure(run, directory=Path(), speed="1")
    links = [facility.router.link, *(service.bus.link for service in facility.services.values())]
    assert {link.lease_s for link in links} == {4.0}
    assert facility.services["logger"].record_extra == ("0/slow/pmd/**",)
    assert replace(facility).proxy is None


def test_a_log_that_ends_early_is_told_with_the_remedy() -> None:
    assert not ends_early(59.2, 60.0)
    assert "ends after 1.2 of 20 s" in ends_early(1.2, 20.0)
