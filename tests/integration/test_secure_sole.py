"""Two services of one name on a secure bus: their certificates let the second one find the first."""

from threading import Event

import pytest
from live_bus import daemon, first
from secure_bus import KEYS, members, secure_bus

from rpod_emulator.daemon import run as emulate
from rpod_motion.daemon import run as move
from rpod_runtime import Inbox
from rpod_runtime.errors import AlreadyRunningError
from rpod_schemas.config.emulator import EmulatorConfig, MotionServiceConfig
from rpod_schemas.messages import read_diagnostics
from rpod_schemas.topics import DIAGNOSTICS

MOTION = {
    "target": "mockup",
    "duration_s": 600.0,
    "motion": {"trajectory": {"kind": "approach", "start_m": [0, 0, 4.0], "end_m": [0, 0, 3.9]}},
}
EMULATOR = {"target": "mockup", "sensors": [{"kind": "pmd"}]}
TIMEOUT_S = 60.0


@pytest.fixture(scope="module")
def bus(tmp_path_factory):
    with secure_bus(tmp_path_factory.mktemp("secure")) as bus:
        yield bus


@pytest.mark.parametrize(
    ("run", "kind", "document"),
    [(move, MotionServiceConfig, MOTION), (emulate, EmulatorConfig, EMULATOR)],
    ids=["motion", "emulator"],
)
def test_a_second_motion_service_or_emulator_of_the_name_does_not_start(bus, run, kind, document):
    name = "motion" if kind is MotionServiceConfig else "emulator"
    config = kind(bus=bus.bus(name), **document)
    inbox = Inbox()
    with bus.node("logger") as listener:
        listener.subscribe(DIAGNOSTICS, inbox.put)
        with daemon(run, config):
            assert first(
                inbox, lambda one: any(item.name == name for item in read_diagnostics(one.decode())), TIMEOUT_S
            )
            with pytest.raises(AlreadyRunningError, match=f"another '{name}' is at work on this bus"):
                run(config, version="test", stop=Event())
