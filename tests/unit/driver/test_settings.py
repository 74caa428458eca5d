"""Settings are written again after a reconnection, in the order in which they were written last."""

from types import SimpleNamespace

import pytest

from rpod_driver.commands import Commands
from rpod_driver.errors import DriverError
from rpod_schemas.config.driver import DriverConfig
from rpod_schemas.control import SettingsRequest


class Camera:
    """A camera that takes an exposure only while the automatic one is off, and has none at power-up."""

    def __init__(self):
        self.connect()
        self.gone = False

    def connect(self):
        self.device = {"automatic": True, "exposure": 0}

    def settings(self):
        if self.gone:
            raise OSError("no such device")
        return self.device

    def apply(self, settings):
        told = dict(self.device)
        for name, value in settings.items():
            if self.gone:
                raise OSError("no such device")
            if name == "exposure" and told["automatic"]:
                raise DriverError("exposure: the camera sets it by itself")
            told[name] = value
        self.device = told


def commands(camera, **settings):
    node = SimpleNamespace(
        serve=lambda *_: None, parameters=SimpleNamespace(offer=lambda *_args, **_options: None)
    )
    told = Commands(node, camera, DriverConfig(kind="pmd", name="front", settings=settings))
    told.restore()
    return told


def change(told, **settings):
    told._change(SettingsRequest(settings=settings))


def test_changes_are_written_again_in_the_order_of_their_last_writes():
    camera = Camera()
    told = commands(camera, automatic=False, exposure=500)
    change(told, automatic=True)
    change(told, automatic=False)
    change(told, exposure=700)
    change(told, automatic=True)
    camera.connect()
    told.restore()
    assert camera.device == {"automatic": True, "exposure": 700}


def test_a_change_that_cannot_be_written_again_is_told_and_the_configuration_counts(caplog):
    camera = Camera()
    told = commands(camera, automatic=False)
    change(told, exposure=700)
    told._configured = {}  # the camera begins with automatic exposure, in which it takes none
    camera.connect()
    told.restore()
    assert camera.device == {"automatic": True, "exposure": 0}
    assert (
        "front: the settings that were changed while it ran (exposure) cannot be written again" in caplog.text
    )
    assert "the camera sets it by itself" in caplog.text


def test_changes_are_kept_where_the_device_itself_fails():
    camera = Camera()
    told = commands(camera)
    change(told, automatic=False, exposure=700)
    camera.connect()
    camera.gone = True
    with pytest.raises(OSError, match="no such device"):
        told.restore()
    camera.gone = False
    told.restore()
    assert camera.device == {"automatic": False, "exposure": 700}
