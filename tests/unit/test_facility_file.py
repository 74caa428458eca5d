"""A facility's file: what its services get, and what is refused before anything is started."""

import errno
import fcntl
import os
from threading import Timer

import pytest
import yaml

from rpod.errors import AlreadyUpError
from rpod.up.command import down_command, ps_command
from rpod.up.daemon import Backoff
from rpod.up.host_state import FacilityStatus, held, holder, read_status, write_status
from rpod.up.resolved import resolve_facility
from rpod_schemas.config.facility.hosts import BackoffConfig
from rpod_schemas.errors import ConfigurationError

ESTIMATOR = {"target": "mockup", "sensors": [{"kind": "pmd"}]}


def facility(folder, services, **fields):
    path = folder / "hall.yaml"
    path.write_text(yaml.safe_dump({"name": "hall", "services": services} | fields, sort_keys=False), "utf-8")
    return path


def test_services_share_the_bus_and_have_their_names_unless_they_say_otherwise(tmp_path):
    path = facility(
        tmp_path,
        {
            "router": {"verb": "router"},
            "front": {"verb": "estimator", "config": ESTIMATOR},
            "tape": {"verb": "logger", "config": {"instance": "log", "bus": {"namespace": "b"}}},
        },
        bus={"connect": "tcp/127.0.0.1:7999", "namespace": "a"},
    )
    router, front, tape = (service.config for service in resolve_facility(path).services)
    assert router.listen == "tcp/127.0.0.1:7999"
    assert (front.instance, front.bus.namespace, front.bus.wait) == ("front", "a", True)
    assert (tape.instance, tape.bus.namespace, tape.bus.connect) == ("log", "b", "tcp/127.0.0.1:7999")
    assert resolve_facility(path).state == (tmp_path / "hall.state").resolve()


def test_a_configuration_may_be_a_file_beside_the_facility_s(tmp_path):
    (tmp_path / "front.yaml").write_text(yaml.safe_dump(ESTIMATOR), "utf-8")
    path = facility(tmp_path, {"front": {"verb": "estimator", "config": "front.yaml"}})
    (front,) = resolve_facility(path).services
    assert front.config.sensors[0].kind == "pmd"


def test_a_driver_is_checked_by_its_own_model(tmp_path):
    device = {"kind": "pmd", "name": "pmd", "device": {"bag": "run.mcap"}}
    path = facility(tmp_path, {"camera": {"verb": "driver", "driver": "replay", "config": device}})
    (camera,) = resolve_facility(path).services
    assert camera.arguments(tmp_path)[:3] == ["driver", "run", "replay"]
    assert camera.settings.restarts == "on_failure"


@pytest.mark.parametrize(
    ("services", "problem"),
    [
        ({}, "services"),
        ({"front": {"verb": "estimater"}}, "services.front.verb"),
        ({"front": {"verb": "estimator", "config": {"targets": "mockup"}}}, "services.front.config"),
        ({"front": {"verb": "estimator", "config": "none.yaml"}}, "none.yaml"),
        ({"camera": {"verb": "driver"}}, "driver: is missing; with `verb: driver` give the driver's name"),
        ({"a": {"verb": "logger", "driver": "ifm"}}, "driver: only `verb: driver` takes `driver`; remove it"),
        ({"camera": {"verb": "driver", "driver": "none"}}, "services.camera.driver"),
        ({"a": {"verb": "logger"}, "b": {"verb": "logger", "config": {"instance": "a"}}}, "another service"),
    ],
)
def test_what_cannot_be_started_is_refused_with_its_place(tmp_path, services, problem):
    with pytest.raises(ConfigurationError, match=problem):
        resolve_facility(facility(tmp_path, services))


def test_waits_double_to_the_longest_and_begin_anew_after_a_steady_while():
    backoff = Backoff(BackoffConfig(first_s=0.1, max_s=0.4, steady_s=60.0))
    assert [backoff.next_s(1.0) for _ in range(4)] == [0.1, 0.2, 0.4, 0.4]
    assert [backoff.next_s(worked_s) for worked_s in (60.0, 0.0)] == [0.1, 0.2]


def test_one_process_holds_a_facility_and_its_end_sets_it_free(tmp_path):
    assert holder(tmp_path) is None
    with held(tmp_path):
        pid = holder(tmp_path)
        assert pid is not None
        write_status(tmp_path, FacilityStatus(name="hall", up=True, pid=pid))
        assert read_status(tmp_path, "hall").healthy
        with pytest.raises(AlreadyUpError, match=f"process {pid} holds"), held(tmp_path):
            pass
    assert not read_status(tmp_path, "hall").up


def test_a_facility_that_a_process_holds_which_is_not_known_is_told_as_such(tmp_path):
    assert "another process holds" in str(AlreadyUpError(tmp_path, None))
    assert "process 7 holds" in str(AlreadyUpError(tmp_path, 7))


def test_a_reader_is_not_taken_for_the_process_that_holds_a_facility(tmp_path):
    """The file may still have the number of a process that was killed; by now it may be another one's."""
    (tmp_path / "manager.pid").write_text("4242")
    with (tmp_path / "manager.pid").open("rb") as reader:
        fcntl.flock(reader, fcntl.LOCK_SH)
        assert holder(tmp_path) is None
        Timer(0.1, fcntl.flock, (reader, fcntl.LOCK_UN)).start()
        with held(tmp_path):
            assert holder(tmp_path) == os.getpid()
    assert (tmp_path / "manager.pid").read_text() == ""


def test_a_facility_whose_state_cannot_be_read_is_not_called_down(tmp_path, monkeypatch, capsys):
    file = tmp_path / "hall.yaml"
    file.write_text("name: hall\nservices: {router: {verb: router}}\n")

    def refuse(path: object, *_: object) -> int:
        raise PermissionError(errno.EACCES, "Permission denied", str(path))

    monkeypatch.setattr("rpod.up.host_state.os.open", refuse)
    for command in (ps_command, down_command):
        assert command(file, as_json=False) == 1
    told = capsys.readouterr()
    assert told.err.count("ask as the user who started it") == 2
    assert told.out == ""
