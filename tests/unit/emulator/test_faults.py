"""Faults of emulated sensors: when they hold, and what a sensor's publisher makes of its messages."""

import time
from pathlib import Path

import numpy as np
import pytest
from kept_messages import KeptMessages
from pydantic import ValidationError

from rpod.play.facility import configure
from rpod.scenarios import find
from rpod_emulator.faults import Faults, FaultyNode, turned
from rpod_runtime.errors import RefusedError
from rpod_runtime.fault_book import FaultBook
from rpod_runtime.sensors import CameraPublisher
from rpod_schemas.config.emulator import EmulatorConfig
from rpod_schemas.config.lidar import LidarConfig
from rpod_schemas.config.pmd import PmdConfig
from rpod_schemas.config.scenario import Scenario
from rpod_schemas.control import FaultRequest
from rpod_schemas.errors import ConfigurationError, SchemaError
from rpod_schemas.faults import FAULTS, PlannedFault
from rpod_schemas.faults.injected import InjectedFault, read_faults
from rpod_schemas.messages import read_image, read_stamp, read_transforms, write_image
from rpod_schemas.poses import make_pose
from rpod_schemas.topics import FAULTS as FAULTS_TOPIC
from rpod_schemas.topics import TF_STATIC, Topic
from rpod_schemas.types import Camera, PmdFrame
from rpod_sim_sensor.faults import Outgoing, injection

SECOND_NS = 1_000_000_000
CAMERA = Camera(width=24, height=36, fx=30.0, fy=30.0, cx=11.5, cy=17.5)


def config(*faults: PlannedFault, **changes) -> EmulatorConfig:
    return EmulatorConfig(target="mockup", faults=faults, **{"sensors": (PmdConfig(),), **changes})


class Camera24:
    """A camera behind a faulty node."""

    def __init__(self, *faults: PlannedFault, **changes) -> None:
        self.kept = KeptMessages()
        self.faults = Faults.of(config(*faults, **changes))
        self.outlet = FaultyNode(self.kept.node, PmdConfig(), self.faults, seed=3)
        self.publisher = CameraPublisher(self.outlet, "pmd", T_chaser_sensor=make_pose())

    def frame(self, stamp_s: float) -> dict[str, object]:
        """Publish a frame; return what came of its parts."""
        before = len(self.kept.received)
        depth_m = np.full((36, 24), 4.0 + stamp_s, np.float32)
        amplitude = np.full((36, 24), 900, np.uint16)
        self.publisher.publish(
            PmdFrame(
                stamp_ns=round(stamp_s * SECOND_NS),
                frame_id="",
                depth_m=depth_m,
                amplitude=amplitude,
                camera=CAMERA,
            )
        )
        depth_m[:], amplitude[:] = -1.0, 1  # as an emulator does, which uses its arrays again
        self.outlet.refresh()
        return {
            received.topic.name.split("/")[-1 if received.topic == TF_STATIC else 1]: received.decode()
            for received in self.kept.received[before:]
        }


def lost_share(message) -> float:
    return float(np.isnan(read_image(message)).mean())


def test_each_fault_of_the_catalogue_can_be_injected_into_the_sensors_that_have_it():
    for fault in FAULTS:
        for kind in fault.kinds:
            assert injection(fault.name, kind, 1).fault == fault.name
    with pytest.raises(SchemaError, match="cannot have the fault"):
        injection("transposed", "pmd", 1)


def test_a_planned_fault_holds_from_its_start_to_before_its_end():
    faults = Faults.of(config(PlannedFault(fault="blackout", start_s=10.0, duration_s=10.0)))
    faults.begin(config(PlannedFault(fault="blackout", start_s=10.0, duration_s=10.0)), 5 * SECOND_NS)
    assert [len(faults.at("pmd", stamp_s * SECOND_NS)) for stamp_s in (14, 15, 24, 25)] == [0, 1, 1, 0]


def test_a_requested_fault_outlives_the_start_of_a_scenario_and_is_of_its_sensor():
    both = (PmdConfig(), LidarConfig())
    faults = Faults.of(config(sensors=both))
    faults.request(FaultRequest(fault="stall", sensor="lidar", duration_s=5.0), 7 * SECOND_NS)
    faults.begin(config(sensors=both), SECOND_NS)
    assert [window.fault.name for window in faults.at("lidar", 8 * SECOND_NS)] == ["stall"]
    assert faults.at("pmd", 8 * SECOND_NS) == []


@pytest.mark.parametrize(
    ("fault", "changes", "text"),
    [
        ("silence", {"time_source": "clock"}, "ask for a blackout instead"),
        ("transposed", {}, "no sensor  can have the fault transposed; there are pmd"),
    ],
)
def test_a_fault_that_cannot_be_is_refused_with_the_remedy(fault, changes, text):
    with pytest.raises(ConfigurationError, match=text):
        Faults.of(config(PlannedFault(fault=fault), **changes))
    with pytest.raises(RefusedError, match=text):
        Faults.of(config(**changes)).request(FaultRequest(fault=fault, duration_s=1.0), 0)
    with pytest.raises(RefusedError, match="cannot begin while a sensor runs"):
        Faults.of(config()).request(FaultRequest(fault="no_mount", duration_s=1.0), 0)


def test_without_a_fault_a_sensor_publishes_as_ever():
    camera = Camera24()
    parts = camera.frame(1.0)
    assert sorted(parts) == ["amplitude", "camera_info", "depth"]
    assert lost_share(parts["depth"]) == 0.0


@pytest.mark.parametrize(
    ("fault", "share", "amplitude_too"),
    [("dropout", 0.6, False), ("glints", 0.4, True), ("blackout", 1.0, True)],
)
def test_lost_pixels_are_whole_patches_that_change_from_frame_to_frame(fault, share, amplitude_too):
    camera = Camera24(PlannedFault(fault=fault))
    frames = [camera.frame(number / 10) for number in range(1, 41)]
    assert np.mean([lost_share(parts["depth"]) for parts in frames]) == pytest.approx(share, abs=0.04)
    first, second = (np.isnan(read_image(frames[number]["depth"])) for number in (0, 1))
    assert np.count_nonzero(first[:, 1:] != first[:, :-1], axis=1).max() <= 11
    assert fault == "blackout" or (first != second).any()
    dark = read_image(frames[0]["amplitude"]) == 0
    assert np.array_equal(dark, first) if amplitude_too else not dark.any()
    again = Camera24(PlannedFault(fault=fault)).frame(0.1)
    np.testing.assert_array_equal(np.isnan(read_image(again["depth"])), first)


def test_a_frozen_frame_keeps_its_content_though_the_sensor_uses_its_arrays_again():
    camera = Camera24(PlannedFault(fault="frozen"))
    first, second = camera.frame(1.0), camera.frame(2.0)
    assert read_stamp(second["depth"].header) == 2 * SECOND_NS
    assert np.array_equal(read_image(second["depth"]), np.full((36, 24), 5.0))
    assert np.array_equal(read_image(first["depth"]), read_image(second["depth"]))


def test_a_second_run_with_the_times_of_the_first_one_has_its_faults():
    fault = PlannedFault(fault="blackout", start_s=1.0, duration_s=1.0)
    camera = Camera24(fault)
    for _ in range(2):
        camera.faults.begin(config(fault), 0)
        shares = [lost_share(camera.frame(stamp_s)["depth"]) for stamp_s in (0.5, 1.5, 2.5)]
        assert shares == [0.0, 1.0, 0.0]


def test_a_fault_that_follows_another_of_its_kind_has_its_own_size():
    planned = [
        PlannedFault(fault="biased", start_s=start_s, duration_s=1.0, size=size_m)
        for start_s, size_m in ((1.0, 0.1), (2.0, 0.5))
    ]
    camera = Camera24(*planned)
    camera.faults.begin(config(*planned), 0)
    depth_m = [read_image(camera.frame(stamp_s)["depth"])[0, 0] for stamp_s in (0.5, 1.5, 2.5)]
    assert np.subtract(depth_m, [4.5, 5.5, 6.5]) == pytest.approx([0.0, 0.1, 0.5], abs=0.02)


def test_what_waits_behind_a_delayed_message_keeps_its_content():
    camera = Camera24(PlannedFault(fault="slow_link", start_s=1.0, duration_s=1.0))
    camera.faults.begin(config(PlannedFault(fault="slow_link", start_s=1.0, duration_s=1.0)), 0)
    for stamp_s in (1.0, 1.9, 2.1):
        camera.frame(stamp_s)
    deadline_s = time.monotonic() + 10.0
    while len([each for each in camera.kept.received if each.topic.name == "pmd/depth/image_raw"]) < 3:
        assert time.monotonic() < deadline_s
        camera.outlet.refresh()
        time.sleep(0.01)
    newest = [each for each in camera.kept.received if each.topic.name == "pmd/depth/image_raw"][-1]
    assert read_image(newest.decode())[0, 0] == pytest.approx(6.1)


def test_frozen_messages_stay_on_their_own_topics():
    frozen = injection("frozen", "pmd", 0)
    for topic in (Topic("pmd/phase/image_raw", "x"), Topic("pmd/depth_sigma/image_raw", "x")):
        message = write_image(SECOND_NS, "pmd", np.ones((2, 2), np.float32), "32FC1")
        (made,) = frozen.apply(Outgoing(topic, "extra", message))
        assert made.topic == topic


def test_a_mount_is_announced_anew_when_a_fault_of_it_begins_and_ends():
    camera = Camera24()
    camera.faults.request(FaultRequest(fault="mount_off", start_s=1.0, duration_s=2.0), 0)
    for stamp_s in (0.5, 1.5, 2.5, 3.5):
        camera.frame(stamp_s)
    mounts = [read_transforms(message)[0][3] for message in camera.kept.of("tf_static")]
    away_m = [round(float(np.linalg.norm(mount.translation)), 3) for mount in mounts]
    assert away_m == [0.0, 0.08, 0.0]


def test_a_second_publisher_has_an_identity_of_its_own():
    camera = Camera24(PlannedFault(fault="second_publisher"))
    camera.frame(1.0)
    depth = {each.peer for each in camera.kept.received if each.topic.name == "pmd/depth/image_raw"}
    assert len(depth) == 2


def test_the_faults_of_a_scenario_reach_its_emulator():
    document = dict(find("mockup-tumbling"))
    scenario = Scenario.model_validate(document | {"faults": [{"fault": "glints", "start_s": 2.0}]})
    facility = configure(scenario, directory=Path("runs"), speed="1")
    assert facility.services["emulator"].faults == (PlannedFault(fault="glints", start_s=2.0),)
    with pytest.raises(ValidationError, match="no sensor 'front' is emulated"):
        Scenario.model_validate(document | {"faults": [{"fault": "glints", "sensor": "front"}]})
    with pytest.raises(ValidationError, match=r"no fault 'gremlins'.*; known are silence"):
        Scenario.model_validate(document | {"faults": [{"fault": "gremlins"}]})
    with pytest.raises(ValidationError, match="no fault 'Freeze'; did you mean frozen"):
        Scenario.model_validate(document | {"faults": [{"fault": "Freeze"}]})
    late = {"fault": "glints", "start_s": scenario.duration_s}
    with pytest.raises(
        ValidationError, match=r"glints has start_s .*, and the scenario's duration_s is .*: begi"
    ):
        Scenario.model_validate(document | {"faults": [late]})


def test_a_size_that_is_asked_for_is_the_faults_size():
    shares = {
        size: lost_share(Camera24(PlannedFault(fault="dropout", size=size)).frame(1.0)["depth"])
        for size in (0.0, 1.0)
    }
    assert shares == {0.0: 0.0, 1.0: 1.0}
    longer = Camera24(PlannedFault(fault="biased", size=0.5)).frame(1.0)["depth"]
    assert np.allclose(read_image(longer), 5.5)
    late = Camera24(PlannedFault(fault="clock_behind", size=0.25)).frame(1.0)["depth"]
    assert read_stamp(late.header) == 0.75 * SECOND_NS


@pytest.mark.parametrize(
    ("asked", "text"),
    [
        ({"fault": "dropout", "size": 1.5}, "size is 1.5, dropout takes 0 to 1 share of the patches"),
        ({"fault": "frozen", "size": 1.0}, "size: frozen has only one"),
        ({"fault": "stop"}, "stop needs service"),
        ({"fault": "dropout", "service": "estimator"}, "dropout is not a fault of a service"),
        ({"fault": "link_stall", "service": "estimator", "sensor": "pmd"}, "not a fault of a sensor"),
        ({"fault": "kill", "service": "estimator"}, "until the service is started again"),
    ],
)
def test_a_fault_that_does_not_fit_its_kind_is_refused(asked, text):
    with pytest.raises(ValidationError, match=text):
        PlannedFault(**asked)


def test_a_fault_of_a_process_is_none_of_the_emulators():
    with pytest.raises(RefusedError, match="the supervisor of a run injects it"):
        Faults.of(config()).request(FaultRequest(fault="stop", service="logger", duration_s=1.0), 0)
    with pytest.raises(ValidationError, match="stop is no fault of a sensor"):
        config(PlannedFault(fault="stop", service="logger"))


def test_a_half_turn_shows_the_target_turned_about_its_own_x_axis():
    faults = Faults.of(config(PlannedFault(fault="half_turn", start_s=1.0, duration_s=1.0)))
    faults.begin(config(PlannedFault(fault="half_turn", start_s=1.0, duration_s=1.0)), SECOND_NS)
    pose = make_pose(translation_m=[1.0, 2.0, 9.0])
    assert turned(pose, faults.at("pmd", SECOND_NS)) == pose
    shown = turned(pose, faults.at("pmd", 2 * SECOND_NS))
    assert np.allclose(shown.apply([3.0, 1.0, 0.0]), [4.0, 1.0, 9.0])


def test_each_fault_is_told_when_it_begins_with_all_before_it():
    planned = (
        PlannedFault(fault="glints", start_s=2.0, duration_s=3.0),
        PlannedFault(fault="blackout", sensor="pmd"),
    )
    faults, kept = Faults.of(config(*planned)), KeptMessages()
    faults.begin(config(*planned), 5 * SECOND_NS)
    book = FaultBook(kept.node)
    for stamp_s in (5, 6, 7, 8):
        book.publish(faults.begun(stamp_s * SECOND_NS, 5 * SECOND_NS))
    told = [read_faults(message) for message in kept.of(FAULTS_TOPIC.name)]
    blackout = InjectedFault("blackout", "pmd", 5 * SECOND_NS)
    glints = InjectedFault("glints", "", 7 * SECOND_NS, 10 * SECOND_NS, 0.4)
    assert told == [[blackout], [blackout, glints]]


def test_a_fault_is_not_taken_before_there_is_a_time_from_which_it_counts():
    with pytest.raises(RefusedError, match="no truth has come"):
        Faults.of(config()).request(FaultRequest(fault="stall", duration_s=5.0), -1)


def test_parts_of_a_frame_are_lost_on_the_bus_one_by_one():
    both = [injection("lost_messages", "pmd", 1, size=0.5) for _ in range(2)]
    lost = []
    for number in range(200):
        message = write_image(number * SECOND_NS, "pmd", np.ones((4, 6), np.float32), "32FC1")
        parts = (Outgoing(Topic(part, "x"), part, message) for part in ("depth", "amplitude"))
        lost.append([each.apply(part)[0].lost for each, part in zip(both, parts, strict=True)])
    assert 0.35 < np.mean([depth != amplitude for depth, amplitude in lost]) < 0.65


def test_each_sensor_and_each_fault_has_random_numbers_of_its_own():
    def drawn(sensor, fault="lost_messages", seed=1):
        made = injection(fault, "pmd", seed, sensor=sensor, size=0.5)
        images = (write_image(k * SECOND_NS, "pmd", np.ones((4, 6), np.float32), "32FC1") for k in range(20))
        return [made.random(Outgoing(Topic("depth", "x"), "depth", each)).random() for each in images]

    one = drawn("near")
    assert drawn("near") == one
    for other in (drawn("far"), drawn("near", fault="dropout"), drawn("near", seed=2)):
        assert not set(one) & set(other)


def test_the_first_frame_of_a_fault_of_stamps_is_stamped_as_the_next_ones():
    begins = PlannedFault(fault="stamp_start", start_s=5.0, duration_s=4.0)
    camera = Camera24(begins)
    camera.publisher.announce(PmdConfig().info(0.02))
    camera.faults.begin(config(begins), 0)
    stamps_ns = [read_stamp(camera.frame(at_s)["depth"].header) for at_s in (4.9, 5.0, 5.1)]
    half_ns = PmdConfig().info(0.02).duration_s * SECOND_NS / 2
    assert stamps_ns == [4_900_000_000, 5_000_000_000 - half_ns, 5_100_000_000 - half_ns]


def test_requests_without_end_are_refused_until_some_are_over():
    faults, asked = Faults.of(config()), FaultRequest(fault="blackout", duration_s=2.0)
    for _ in range(500):
        faults.request(asked, 0)
    with pytest.raises(RefusedError, match="500 faults are planned or active already"):
        faults.request(asked, SECOND_NS)
    faults.request(asked, 3 * SECOND_NS)
    assert len(faults.begun(3 * SECOND_NS, 0)) == 1
