"""The view on a real bus: how much it draws, and that nobody waits for it, whatever the viewer does."""

import json
import os
import signal
import time
from collections import Counter
from contextlib import contextmanager
from pathlib import Path
from threading import Event

import numpy as np
import psutil
import pytest
from live_bus import TIMEOUT_S, collect, daemon, first
from pmd_frames import frame_of
from recordings import read_recording
from scipy.spatial.transform import RigidTransform

from rpod_runtime import Inbox, QueryFailedError
from rpod_runtime.sensors import CameraPublisher
from rpod_schemas.config.facility.view import ViewConfig
from rpod_schemas.control import StatusReply
from rpod_schemas.messages import read_diagnostics
from rpod_schemas.topics import DEPTH, DIAGNOSTICS
from rpod_schemas.types import Camera
from rpod_view.daemon import run
from rpod_view.errors import ViewerFailedError

CAMERA = Camera(width=88, height=72, fx=170.0, fy=170.0, cx=43.5, cy=35.5)
RATE_HZ = 45.0


class Facility:
    """A camera that publishes, one who counts its frames, and a view."""

    def __init__(self, bus) -> None:
        self._bus = bus
        self._camera = CameraPublisher(
            bus.node("camera"), "pmd", T_chaser_sensor=RigidTransform.from_translation([0.0, 0.1, 0.0])
        )
        depth_m = np.full((CAMERA.height, CAMERA.width), 3.0, np.float32)
        self._frame = frame_of(depth_m, amplitude=depth_m.astype(np.uint16), camera=CAMERA)
        self._published = 0
        self._counted, self._health = Inbox(capacity_bytes=4 << 30), Inbox()
        self._node = bus.node("counting")
        self._node.subscribe(DEPTH.of("pmd"), self._counted.put, recover=True, history=True)
        self._node.subscribe(DIAGNOSTICS, self._health.put)

    def config(self, **changes) -> ViewConfig:
        return ViewConfig(bus=self._bus.config, **changes)

    def publish(self, count: int) -> float:
        """Publish so many frames at the camera's rate; return how long it took, s."""
        pause, started_s = Event(), time.monotonic()
        for number in range(count):
            pause.wait(max(started_s + number / RATE_HZ - time.monotonic(), 0.0))
            self._published += 1
            self._camera.publish(self._frame.model_copy(update={"stamp_ns": time.time_ns()}))
        return time.monotonic() - started_s

    def publish_until_skipped(self) -> None:
        """Publish until the view has nobody who takes what it draws: what is on the way fills up first."""
        for _ in range(40):
            self.publish(30)
            if self.counters()["skipped"] > 2:
                return
        raise AssertionError("the view skips nothing")

    def all_received(self) -> bool:
        """Return whether every frame has come to whoever counts."""
        return len(collect(self._counted, self._published)) == self._published

    def await_health(self, fits) -> None:
        def of_view(received):
            return any(each.name == "view" and fits(each) for each in read_diagnostics(received.decode()))

        assert first(self._health, of_view)

    def counters(self) -> Counter:
        return Counter(self._node.ask("view", "status", StatusReply, timeout_s=TIMEOUT_S).counters)

    def await_counter(self, name: str, least: int) -> None:
        self.await_health(lambda each: int(each.values.get(name, 0)) >= least)


@pytest.fixture
def facility(bus):
    return Facility(bus)


@contextmanager
def shown(facility, **changes):
    config = facility.config(**changes)
    with daemon(run, config) as stop:
        facility.await_health(lambda each: each.message.startswith(("shown in", "written to")))
        yield stop


def test_of_a_fast_camera_ten_frames_a_second_are_drawn_at_most(facility, tmp_path):
    with shown(facility, save=tmp_path / "run.rrd"):
        lasted_s = facility.publish(90)
        facility.await_counter("received/pmd/depth/image_raw", 20)
        counters = facility.counters()
    drawn = read_recording(tmp_path / "run.rrd")["image/pmd/depth"].stamps_ns
    assert 3 <= len(drawn) <= 10.0 * lasted_s + 2
    assert len(drawn) == len(set(drawn)) >= counters["drawn"]
    assert facility.all_received()


def test_nothing_is_subscribed_that_is_not_drawn_and_nothing_recovered(facility, tmp_path):
    with shown(facility, save=tmp_path / "run.rrd"):
        facility.publish(10)
        counters = facility.counters()
    received = {name.removeprefix("received/") for name in counters if name.startswith("received/")}
    parts = {f"pmd/{part}" for part in ("depth/image_raw", "amplitude/image_raw", "camera_info")}
    assert received <= parts | {
        "truth/odometry", "tf_static", "estimate/odometry", "estimate/status", "diagnostics",
    }  # fmt: skip
    assert not any(count for name, count in counters.items() if name.startswith("recovered/"))


def test_a_viewer_that_stands_still_holds_up_nobody_and_is_shown_the_newest_again(facility):
    before = set(psutil.Process().children())
    with shown(facility, viewer="web"):
        (viewer,) = set(psutil.Process().children()) - before
        facility.publish(10)
        facility.await_counter("drawn", 1)
        os.killpg(viewer.pid, signal.SIGSTOP)
        try:
            facility.publish_until_skipped()
            assert facility.all_received()
        finally:
            os.killpg(viewer.pid, signal.SIGCONT)
        drawn = facility.counters()["drawn"]
        facility.publish(10)
        facility.await_counter("drawn", drawn + 1)
    assert not viewer.is_running()


def test_a_viewer_that_stands_still_does_not_hold_up_the_end(facility):
    before = set(psutil.Process().children())
    with shown(facility, viewer="web"):  # ends within the daemon's time, or fails
        (viewer,) = set(psutil.Process().children()) - before
        os.killpg(viewer.pid, signal.SIGSTOP)
        facility.publish_until_skipped()
    assert not viewer.is_running()


def test_the_view_ends_when_its_viewer_is_closed(facility):
    before = set(psutil.Process().children())
    with shown(facility, viewer="web") as stop:
        (viewer,) = set(psutil.Process().children()) - before
        os.killpg(viewer.pid, signal.SIGTERM)
        assert stop.wait(TIMEOUT_S)
    with pytest.raises(QueryFailedError):
        facility.counters()


def test_a_viewer_listens_on_loopback_alone(facility):
    before = set(psutil.Process().children())
    with shown(facility, viewer="web"):
        (viewer,) = set(psutil.Process().children()) - before
        group = [viewer, *viewer.children(recursive=True)]
        listening = [
            connection.laddr.ip
            for process in group
            for connection in process.net_connections("tcp")
            if connection.status == psutil.CONN_LISTEN
        ]
    assert len(listening) >= 2
    assert set(listening) == {"127.0.0.1"}


def test_a_viewer_reports_its_use_to_nobody(facility):
    before = set(psutil.Process().children())
    with shown(facility, viewer="web"):
        (viewer,) = set(psutil.Process().children()) - before
        settings = Path(viewer.environ()["XDG_CONFIG_HOME"])
        analytics = json.loads((settings / "rerun" / "analytics.json").read_text("utf-8"))
        assert analytics["analytics_enabled"] is False
    assert not settings.exists()


def test_a_port_that_is_taken_is_one_line(facility):
    config = facility.config(viewer="web", port=int(facility.config().bus.connect.rsplit(":", 1)[1]))
    with (
        pytest.raises(
            ViewerFailedError, match=r"cannot listen on 127\.0\.0\.1:\d+ \(Address already in use\)"
        ),
        daemon(run, config) as stop,
    ):
        assert stop.wait(TIMEOUT_S)
