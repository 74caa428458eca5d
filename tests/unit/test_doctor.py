"""What the doctor says of figures, of ports and of disks, without a bus."""

import json
import socket

import pytest
import yaml

from rpod.doctor.bus import check_link
from rpod.doctor.command import doctor_command
from rpod.doctor.finding import Level
from rpod.doctor.host import check_clock, check_disk, clock, disk, port, room, versions
from rpod_security.authority import Authority


@pytest.mark.parametrize(
    ("told", "level"),
    [((True, 0.0, 0.1), Level.FAIL), ((False, 0.01, 0.1), Level.NOTE), ((False, 0.0005, 0.01), Level.OK)],
)
def test_a_clock_is_checked_by_what_the_kernel_says(told, level):
    found = check_clock(*told)
    assert found.level is level
    assert bool(found.remedy) == (level is not Level.OK)


def test_the_kernel_of_this_machine_has_an_answer():
    assert clock().check == "clock"


@pytest.mark.parametrize(("rate_mb_s", "level"), [(20, Level.FAIL), (60, Level.NOTE), (300, Level.OK)])
def test_a_disk_is_compared_with_a_camera(rate_mb_s, level):
    assert check_disk("disk", rate_mb_s).level is level


@pytest.mark.parametrize(
    ("bytes_s", "level", "frames"),
    [(5e5, Level.FAIL, "0.6"), (1.25e6, Level.NOTE, "1.5"), (5e7, Level.OK, "61.9")],
)
def test_a_link_is_told_in_frames_of_a_camera(bytes_s, level, frames):
    found = check_link("link", 0.001, bytes_s)
    assert found.level is level
    assert f"{frames} frames/s" in found.text


def test_a_port_that_another_program_holds_is_found():
    with socket.socket() as held:
        held.bind(("127.0.0.1", 0))
        held.listen()
        number = held.getsockname()[1]
        taken = port(f"tcp/127.0.0.1:{number}", reachable=False)
        assert port(f"tcp/127.0.0.1:{number}", reachable=True).level is Level.OK
    assert taken.level is Level.FAIL
    assert "in use" in taken.text
    assert port(f"tcp/127.0.0.1:{number}", reachable=False).level is Level.OK
    assert port("unixsock-stream/router.sock", reachable=False).level is Level.UNCHECKED


def test_this_machine_runs_the_versions_that_it_runs(tmp_path, monkeypatch):
    assert {found.level for found in versions()} == {Level.OK}
    assert {found.check for found in room()} == {"memory", "descriptors"}
    monkeypatch.setattr("rpod.doctor.host._DISK_BYTES", 1 << 20)
    free, rate = disk(tmp_path / "logs" / "later")
    assert "GB are free" in free.text
    assert "MB/s" in rate.text
    assert not list(tmp_path.iterdir())


def test_without_a_router_the_command_fails_and_says_what_to_start(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("rpod.doctor.host._DISK_BYTES", 1 << 20)
    monkeypatch.setattr("rpod.doctor.command._TIMEOUT_S", 0.1)
    code = doctor_command(
        None, connect="tcp/127.0.0.1:9", other_router=None, directory=tmp_path, as_json=True
    )
    told = json.loads(capsys.readouterr().out)
    assert code == 1
    assert not told["ok"]
    (link,) = (each for each in told["findings"] if each["check"].startswith("link"))
    assert link["level"] == "fail"
    assert "rpod router" in link["remedy"]


def test_the_certificate_of_each_service_of_a_facility_is_checked(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("rpod.doctor.host._DISK_BYTES", 1 << 20)
    monkeypatch.setattr("rpod.doctor.command._TIMEOUT_S", 0.1)
    credentials = Authority.create(tmp_path / "pki").issue("logger", "logger")
    bus = {"connect": "tls/127.0.0.1:9", "credentials": str(credentials)}
    others = bus | {"credentials": str(tmp_path / "none")}
    services = {
        "logger": {"verb": "logger"},
        "estimator": {
            "verb": "estimator",
            "config": {"target": "mockup", "sensors": [{"kind": "pmd"}], "bus": others},
        },
    }
    file = tmp_path / "hall.yaml"
    file.write_text(yaml.safe_dump({"name": "hall", "services": services, "bus": bus}), "utf-8")
    code = doctor_command(file, connect=None, other_router=None, directory=tmp_path, as_json=True)
    told = {each["check"]: each for each in json.loads(capsys.readouterr().out)["findings"]}
    assert code == 1
    assert told["certificate logger"]["level"] == "ok"
    assert told["certificate none"]["level"] == "fail"
