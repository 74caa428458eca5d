"""A router each on two hosts: one link, each checks its own clients, and what the doctor says of them."""

from contextlib import ExitStack

import numpy as np
import pytest
from live_bus import Bus, collect, first

from rpod.doctor import bus as doctor
from rpod.doctor.finding import Level
from rpod_runtime import Inbox
from rpod_runtime.bus.session import free_endpoint, open_router
from rpod_schemas.config.service import ESTIMATOR_ID, BusConfig, RouterConfig
from rpod_schemas.messages import write_odometry
from rpod_schemas.poses import make_pose
from rpod_schemas.topics import ESTIMATE, TRUTH
from rpod_schemas.types import Odometry


@pytest.fixture
def hosts():
    """Return the endpoints of two routers, of which the second connects to the first."""
    with ExitStack() as stack:
        sensors, control = free_endpoint(), free_endpoint()
        stack.enter_context(open_router(RouterConfig(listen=control, connect=(sensors,))))
        stack.enter_context(open_router(RouterConfig(listen=sensors)))
        yield sensors, control


def test_two_routers_see_each_other_also_if_the_one_that_connects_was_first(hosts):
    sensors, control = hosts
    found = doctor.routers(BusConfig(connect=control), sensors)
    assert found.level is Level.OK, found


def test_two_routers_that_nobody_connected_are_found(monkeypatch):
    monkeypatch.setattr(doctor, "_SEEN_S", 0.3)
    with ExitStack() as stack:
        here, there = free_endpoint(), free_endpoint()
        for endpoint in (here, there):
            stack.enter_context(open_router(RouterConfig(listen=endpoint)))
        found = doctor.routers(BusConfig(connect=here), there)
    assert found.level is Level.FAIL
    assert "connect" in found.remedy


def test_the_link_is_measured_and_services_are_named_with_their_version(bus):
    bus.node("camera")
    found = {each.check: each for each in doctor.link(bus.config)}
    assert "MB/s each way" in found[f"link {bus.endpoint}"].text
    assert found["service camera"].level is Level.FAIL  # of version "test"


def test_the_truth_is_denied_to_an_estimator_across_the_link_too(hosts):
    sensors, control = hosts
    with ExitStack() as stack:
        assert doctor.routers(BusConfig(connect=control), sensors).level is Level.OK
        robots = Bus(sensors, stack).node("robots")
        estimator = Bus(control, stack).node("estimator", zenoh_id=ESTIMATOR_ID)
        guest = Bus(control, stack).node("guest")
        heard, denied, allowed = Inbox(), Inbox(), Inbox()
        guest.subscribe(TRUTH, heard.put)
        estimator.subscribe(TRUTH, denied.put)
        estimator.subscribe(ESTIMATE, allowed.put)
        truth, other = robots.publisher(TRUTH), robots.publisher(ESTIMATE)
        pose = Odometry(
            stamp_ns=1_767_225_600_000_000_000,
            frame_id="chaser",
            child_frame_id="target",
            pose=make_pose(translation_m=[0.0, 0.0, 3.0]),
            linear_m_s=np.zeros(3),
            angular_rad_s=np.zeros(3),
        )

        def arrived(inbox):
            for publisher in (truth, other):
                publisher.publish(write_odometry(pose))
            return first(inbox, bool, 0.2)

        assert any(arrived(heard) for _ in range(50))
        assert any(arrived(allowed) for _ in range(50))
        assert not collect(denied, 1, 0.5)
