"""What the process of an Ouster sends, with a fake of ouster-sdk: no device and no SDK is needed."""

import argparse
import sys
import time
from types import SimpleNamespace

import numpy as np
import pytest

from rpod_driver.adapters.ouster import OusterConfig, open_driver, scans

FIRST_NS = 1_600_000_000_000_000_000
SHAPE = (2, 4)
CHANNELS = SimpleNamespace(RANGE="RANGE", SIGNAL="SIGNAL", REFLECTIVITY="REFLECTIVITY")


class Scan:
    """A scan of two rows and four columns, 10 ms apart."""

    frame_id = 7

    def __init__(self, first_ns=FIRST_NS, channels=("RANGE", "SIGNAL", "REFLECTIVITY")) -> None:
        self.status = np.ones(4, int)
        self.timestamp = first_ns + 10_000_000 * np.arange(4)
        self.fields = channels

    def field(self, name):
        assert name in self.fields
        return np.full(SHAPE, 1 + ("RANGE", "SIGNAL", "REFLECTIVITY").index(name), np.uint32)


class Sender:
    def __init__(self) -> None:
        self.sent: list[tuple] = []

    def send(self, kind, arrays=None, **fields):
        self.sent.append((time.monotonic(), kind, arrays, fields))

    def of(self, kind):
        return [each for each in self.sent if each[1] == kind]


def sent(monkeypatch, *given, sensors=1, play=False, index=-1):
    """Return what is sent of scans of a source."""
    asked = {}
    form = SimpleNamespace(pixels_per_column=2, columns_per_frame=4)
    mode = SimpleNamespace(timestamp_mode="TIME_FROM_INTERNAL_OSC")
    infos = [
        SimpleNamespace(prod_line="OS-1-32", fw_rev="v3", sn=str(number), format=form, config=mode)
        for number in range(sensors)
    ]

    def open_source(_source, **options):
        asked.update(options)
        return Source([[scan] for scan in given])

    class Source(list):
        sensor_info = infos

        def close(self):
            pass

    core = SimpleNamespace(
        ChanField=CHANNELS,
        XYZLut=lambda _info, **_: lambda _scan: np.ones((*SHAPE, 3)),
        destagger=lambda _info, image: image,
    )
    sdk = SimpleNamespace(open_source=open_source, core=core, __version__="1.0")
    monkeypatch.setitem(sys.modules, "ouster", SimpleNamespace(sdk=sdk))
    sender = Sender()
    options = argparse.Namespace(
        source="a.osf", metadata=None, ptp_offset=37.0, play=play, sensor_index=index
    )
    scans._send(sender, options)
    assert asked["sensor_idx"] == index
    return sender


@pytest.mark.parametrize(
    ("channels", "value"),
    [(("RANGE", "SIGNAL", "REFLECTIVITY"), 2.0), (("RANGE", "REFLECTIVITY"), 3.0), (("RANGE",), None)],
)
def test_the_intensity_is_the_best_that_the_profile_has(monkeypatch, channels, value):
    ((*_, arrays, _),) = sent(monkeypatch, Scan(channels=channels)).of("frame")
    assert ("intensity" in arrays) == (value is not None)
    assert value is None or (arrays["intensity"] == value).all()


def test_a_recording_is_played_at_its_pace_and_its_pauses_are_announced(monkeypatch):
    begun_s = time.monotonic()
    given = (Scan(), Scan(FIRST_NS + 200_000_000), Scan(FIRST_NS))
    sender = sent(monkeypatch, *given, play=True)
    first_s, second_s, third_s = (each[0] for each in sender.of("frame"))
    assert first_s - begun_s < 0.2
    assert second_s - first_s >= 0.199
    assert third_s - second_s < 0.2  # its sensor had started again
    assert [0.0 < fields["pause_s"] <= 0.2 for *_, fields in sender.of("idle")] == [True]


def test_a_live_sensor_is_not_held_back(monkeypatch):
    sender = sent(monkeypatch, Scan(), Scan(FIRST_NS + 10**12))
    assert len(sender.of("frame")) == 2
    assert not sender.of("idle")


def test_a_source_of_several_sensors_is_refused_with_their_names(monkeypatch):
    reason = r"scans of 2 sensors \(0: OS-1-32 0; 1: OS-1-32 1\); set device\.sensor_index"
    with pytest.raises(RuntimeError, match=reason):
        sent(monkeypatch, Scan(), sensors=2)
    assert sent(monkeypatch, Scan(), index=1).of("frame")


def test_a_file_is_played_with_stamps_of_now_and_a_live_sensor_is_not(tmp_path):
    (tmp_path / "a.osf").touch()

    def opened(source, **device):
        told = {"name": "top", "device": {"python": sys.executable, "source": source} | device}
        return open_driver(OusterConfig.model_validate(told))

    played, live = opened(str(tmp_path / "a.osf"), sensor_index=1), opened("os-1.local")
    assert played._command[2:] == [
        "--ptp-offset", "37", "--sensor-index", "1", "--play", str(tmp_path / "a.osf"),
    ]  # fmt: skip
    assert played._environment.stamps.source == "mapped"
    assert live._command[2:] == ["--ptp-offset", "37", "os-1.local"]
    assert live._environment.stamps.source == "auto"
