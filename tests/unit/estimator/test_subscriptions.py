"""What becomes of messages on their way to the navigator: taken, passed over, or refused with a reason."""

from threading import Timer
from time import monotonic
from types import SimpleNamespace

import numpy as np
import pytest

from rpod_estimator.frame_reader import _defect
from rpod_estimator.inputs import subscriptions
from rpod_estimator.inputs.book import Loss
from rpod_estimator.inputs.subscriptions import Subscriptions
from rpod_pose.navigation.state import Output
from rpod_runtime import BusClock, Received, WallClock
from rpod_runtime.delivery.holders import Peer
from rpod_runtime.errors import RefusedError
from rpod_runtime.health import HealthBook
from rpod_runtime.sensor_data.stamp_watch import StampWatch
from rpod_schemas.config.estimator import EstimatorConfig
from rpod_schemas.config.service import BusConfig
from rpod_schemas.control import ResetRequest
from rpod_schemas.errors import ConfigurationError
from rpod_schemas.messages import (
    write_camera,
    write_clock,
    write_diagnostics,
    write_image,
    write_lidar_info,
    write_pmd_info,
    write_points,
    write_transforms,
)
from rpod_schemas.poses import make_pose
from rpod_schemas.rmw.cdr import encode
from rpod_schemas.rmw.wire import Attachment
from rpod_schemas.topics import (
    AMPLITUDE,
    CAMERA_INFO,
    CONTRADICTION,
    DEPTH,
    DIAGNOSTICS,
    LIDAR_INFO,
    PMD_INFO,
    POINTS,
    TF_STATIC,
)
from rpod_schemas.types import (
    Camera,
    Diagnostic,
    EstimatorStatus,
    Health,
    LidarInfo,
    Mode,
    PmdFrame,
    PmdInfo,
    SensorSync,
)

SECOND_NS = 1_000_000_000
NOW_NS = 1_000 * SECOND_NS
CAMERA = Camera(width=6, height=4, fx=5.0, fy=5.0, cx=2.5, cy=1.5)
DEPTH_M = np.full((4, 6), 3.0, np.float32)
CLOUD = {name: np.arange(6, dtype=np.float32).reshape(2, 3) for name in ("x", "y", "z", "intensity")}
MOUNT = make_pose(translation_m=[0.0, -0.05, 0.0])


NOBODY, EMULATOR, DRIVER = Peer(bytes(16)), Peer(b"e" * 16, "e0"), Peer(b"d" * 16, "d0")


class FakeNode:
    """Keeps the sinks, so that a test hands messages to them, and the books of a real node."""

    def __init__(self, time_source):
        self.health = HealthBook("estimator")
        self.sinks, self.recovered, self.past = {}, {}, {}
        self.config = SimpleNamespace(bus=BusConfig())
        self.clock = BusClock() if time_source == "clock" else WallClock()
        self.refused = []

    def subscribe(self, topic, sink, *, recover=False, history=False):
        self.sinks[topic] = sink
        self.recovered[topic] = recover
        self.past[topic] = history

    def watch_publishers(self, gone, came):
        self.gone, self.came = gone, came

    def watch_tokens(self, _, take):
        self.hears = take

    def reject(self, topic, error):
        self.refused.append((topic, str(error.reason)))
        self.health.reject(topic, error)


class Bench:
    def __init__(self, **config):
        sensors = config.pop(
            "sensors", [{"kind": "pmd", "T_chaser_sensor": {"translation_m": [0, -0.05, 0]}}]
        )
        self._sent = 0
        self.node = FakeNode(config.get("time_source", "wall"))
        self.inputs = Subscriptions(self.node, EstimatorConfig(target="mockup", sensors=sensors, **config))

    def send(
        self, topic, message, *, arrival_ns=NOW_NS, damage=lambda payload: payload, arrival_s=0.0, by=NOBODY
    ):
        payload = memoryview(bytes(damage(encode(message))))
        attachment = Attachment(1, 0, by.gid)
        received = Received(topic, "k", payload, attachment, arrival_ns, arrival_s, session=by.session)
        self.node.sinks[topic](received)

    def send_frame(
        self,
        stamp_ns,
        *,
        amplitude=True,
        shaded=True,
        frame_id="pmd_optical",
        camera=CAMERA,
        frozen=False,
        **how,
    ):
        if camera is not None:
            self.send(CAMERA_INFO.of("pmd"), write_camera(stamp_ns, frame_id, camera), **how)
        depth_m = DEPTH_M
        if not frozen:  # noise never repeats
            depth_m = DEPTH_M.copy()
            depth_m[0, 0] += np.float32(1e-3 * self._sent)
            self._sent += 1
        self.send(DEPTH.of("pmd"), write_image(stamp_ns, frame_id, depth_m, "32FC1"), **how)
        if amplitude:
            image = np.arange(24, dtype=np.uint16).reshape(4, 6) if shaded else np.ones((4, 6), np.uint16)
            self.send(AMPLITUDE.of("pmd"), write_image(stamp_ns, frame_id, image, "mono16"), **how)

    def send_scan(self, stamp_ns, fields=None, *, frame_id="lidar", **how):
        self.send(POINTS.of("lidar"), write_points(stamp_ns, frame_id, fields or CLOUD), **how)

    def arrived(self):
        """Return all that there is to process, in order."""
        found = []
        while (frame := self.inputs.newest(0.0)) is not None:
            found.append(frame)
        return found

    @property
    def counters(self):
        return self.node.health.counters()


def lidar_bench(**config):
    return Bench(sensors=[{"kind": "lidar", "T_chaser_sensor": {}}], **config)


def test_a_frame_is_handed_over_with_its_mount():
    bench = Bench()
    bench.send_frame(NOW_NS)
    (arrived,) = bench.arrived()
    frame = arrived.measurement
    assert (arrived.sensor, arrived.stamp_ns, frame.stamp_ns, arrived.reason) == ("pmd", NOW_NS, NOW_NS, "")
    np.testing.assert_array_equal(frame.data.depth_m, DEPTH_M)
    assert frame.data.amplitude.dtype == np.uint16
    np.testing.assert_array_equal(frame.data.camera.K, CAMERA.K)
    np.testing.assert_allclose(frame.T_chaser_sensor.as_matrix(), MOUNT.as_matrix())


def test_a_scan_is_handed_over_organised():
    bench = lidar_bench()
    bench.send_scan(NOW_NS)
    (arrived,) = bench.arrived()
    assert arrived.measurement.data.points_m.shape == (2, 3, 3)
    np.testing.assert_array_equal(arrived.measurement.data.intensity, CLOUD["intensity"])


def test_the_arrival_of_a_frame_is_that_of_its_last_part():
    bench = Bench()
    bench.send(CAMERA_INFO.of("pmd"), write_camera(NOW_NS, "c", CAMERA), arrival_s=1.0)
    bench.send(DEPTH.of("pmd"), write_image(NOW_NS, "c", DEPTH_M, "32FC1"), arrival_s=3.0)
    bench.send(
        AMPLITUDE.of("pmd"), write_image(NOW_NS, "c", np.ones((4, 6), np.uint8), "mono8"), arrival_s=2.0
    )
    (arrived,) = bench.arrived()
    assert arrived.arrival_s == 3.0


def test_a_repeated_frame_is_refused_and_the_third_shows_a_frozen_stream_until_another_comes():
    bench, reasons = Bench(), []
    for number in range(5):
        bench.send_frame(NOW_NS + number, frozen=True)
        (arrived,) = bench.arrived()
        reasons.append((arrived.refused, arrived.measurement is None, arrived.is_frozen))
    assert reasons == [("", False, False), ("frozen", True, False), *[("frozen", True, True)] * 3]
    assert arrived.reason.startswith("frozen: the last 5 frames are identical to the bit; restart")
    other = DEPTH_M.copy()
    other[0, 0] += 1e-4
    bench.send(CAMERA_INFO.of("pmd"), write_camera(NOW_NS + 9, "pmd_optical", CAMERA))
    bench.send(DEPTH.of("pmd"), write_image(NOW_NS + 9, "pmd_optical", other, "32FC1"))
    bench.send(
        AMPLITUDE.of("pmd"), write_image(NOW_NS + 9, "pmd_optical", np.ones((4, 6), np.uint16), "mono16")
    )
    (arrived,) = bench.arrived()
    assert arrived.measurement is not None


def test_an_amplitude_that_is_the_same_everywhere_is_told_and_its_frame_is_used_without_it():
    bench = Bench()
    bench.send_frame(NOW_NS, shaded=False)
    (arrived,) = bench.arrived()
    assert arrived.measurement is not None
    assert arrived.measurement.data.amplitude is None
    assert arrived.defect.startswith(
        "all pixels of its amplitude are 1, so it is not used; correct its driver"
    )


@pytest.mark.parametrize(
    ("fx", "told"), [(5.0, ""), (5.1, ""), (5.25, "5.0% above fy"), (4.5, "10.0% below fy")]
)
def test_focal_lengths_of_pixels_that_are_far_from_square_are_told(fx, told):
    bench = Bench()
    bench.send_frame(NOW_NS, camera=CAMERA.model_copy(update={"fx": fx}))
    (arrived,) = bench.arrived()
    assert arrived.measurement is not None
    assert told in arrived.defect
    assert bool(told) == bool(arrived.defect)


def test_an_amplitude_of_zeros_is_a_doubt_where_many_pixels_have_a_range():
    def defect_of(measured: int) -> str:
        depth_m = np.full((30, 40), np.nan, np.float32)
        depth_m.flat[:measured] = 3.0
        camera = CAMERA.model_copy(update={"width": 40, "height": 30})
        dark = np.zeros((30, 40), np.uint16)
        frame = PmdFrame(stamp_ns=1, frame_id="c", depth_m=depth_m, amplitude=dark, camera=camera)
        told, unused = _defect(frame)
        assert not unused
        return told

    assert defect_of(200) == ""
    assert defect_of(300).endswith(
        "are 0 although 300 pixels have a range; correct its driver, or expose longer"
    )


@pytest.mark.parametrize(
    ("pixels", "told"),
    [({}, ""), ({2: -1.0, 3: -1.0}, ""), ({2: -1.0, 3: -2.5}, "2 pixels have a negative depth")],
)
def test_negative_distances_are_told_unless_one_value_stands_for_none(pixels, told):
    bench, depth_m = Bench(), DEPTH_M.copy()
    depth_m.flat[list(pixels)] = list(pixels.values())
    bench.send(CAMERA_INFO.of("pmd"), write_camera(NOW_NS, "pmd_optical", CAMERA))
    bench.send(DEPTH.of("pmd"), write_image(NOW_NS, "pmd_optical", depth_m, "32FC1"))
    (arrived,) = [*bench.arrived(), *bench.inputs.rest()][:1]
    assert arrived.measurement is not None
    assert told in arrived.defect
    assert bool(told) == bool(arrived.defect)


@pytest.mark.parametrize("length", [2, 40])
def test_frames_of_an_earlier_time_under_new_stamps_are_told_and_the_third_is_a_frozen_stream(length):
    bench, found = Bench(), []
    for number in range(length + 4):
        bench._sent = number % length
        bench.send_frame(NOW_NS + number)
        found += bench.arrived()
    assert [each.is_frozen for each in found] == [False] * (length + 2) + [True] * 2
    text = (
        f"it is the frame {length} before it, to the bit: a recording or a ring of buffers is sent in a loop"
    )
    assert [each.defect.startswith(text) for each in found] == [False] * length + [True] * 4
    bench._sent = length
    bench.send_frame(NOW_NS + 99)
    (new,) = bench.arrived()
    assert (new.is_frozen, new.defect) == (False, "")


def test_scans_without_any_return_are_alike_and_not_frozen():
    bench = lidar_bench()
    nothing = {name: np.full((2, 3), np.nan, np.float32) for name in CLOUD}
    for number in range(5):
        bench.send_scan(NOW_NS + number, nothing)
        assert all(arrived.refused != "frozen" for arrived in bench.arrived())


def test_the_newest_wins_and_what_it_passes_over_is_counted():
    bench = Bench()
    for number in range(5):
        bench.send_frame(NOW_NS + number)
    assert [frame.stamp_ns for frame in bench.arrived()] == [NOW_NS + 4]
    assert bench.counters["dropped/pmd"] == 4
    assert bench.counters["incomplete/pmd"] == 0


def test_two_sensors_take_turns_by_stamp():
    bench = Bench(sensors=[{"kind": "pmd", "T_chaser_sensor": {}}, {"kind": "lidar", "T_chaser_sensor": {}}])
    bench.send_frame(NOW_NS)
    bench.send_scan(NOW_NS - 5)
    assert [frame.sensor for frame in bench.arrived()] == ["lidar", "pmd"]


def test_at_the_end_what_waits_is_handed_over_and_what_comes_then_is_not():
    bench = Bench(sensors=[{"kind": "pmd", "T_chaser_sensor": {}}, {"kind": "lidar", "T_chaser_sensor": {}}])
    bench.send_frame(NOW_NS)
    bench.send_scan(NOW_NS - 5)
    rest = bench.inputs.rest()
    assert next(rest).sensor == "lidar"
    bench.send_scan(NOW_NS)
    assert [frame.sensor for frame in rest] == ["pmd"]
    assert bench.counters["dropped/lidar"] == 1


@pytest.mark.parametrize(("time_source", "recovers"), [("wall", False), ("clock", True)])
def test_only_in_lockstep_is_a_missed_part_asked_for_again(time_source, recovers):
    bench = Bench(time_source=time_source)
    assert bench.node.recovered[DEPTH.of("pmd")] is recovers


def test_the_mount_comes_from_the_static_transforms():
    bench = Bench(sensors=[{"kind": "pmd"}])
    bench.send(TF_STATIC, write_transforms(0, [("chaser", "pmd_optical", MOUNT)]))
    bench.send_frame(NOW_NS)
    (arrived,) = bench.arrived()
    np.testing.assert_allclose(arrived.measurement.T_chaser_sensor.as_matrix(), MOUNT.as_matrix())


def test_a_transform_that_arrives_with_the_frame_is_known_for_it():
    bench = Bench(sensors=[{"kind": "pmd"}])
    bench.send_frame(NOW_NS)
    bench.send(TF_STATIC, write_transforms(0, [("chaser", "pmd_optical", MOUNT)]))
    (arrived,) = bench.arrived()
    assert arrived.measurement is not None


def test_a_flood_of_images_does_not_wash_the_transforms_away():
    bench = Bench(sensors=[{"kind": "pmd"}])
    bench.send(TF_STATIC, write_transforms(0, [("chaser", "pmd_optical", MOUNT)]))
    for number in range(300):
        bench.send_frame(NOW_NS + number)
    (arrived,) = bench.arrived()
    assert arrived.measurement is not None
    assert arrived.stamp_ns == NOW_NS + 299
    assert bench.counters["overflowed/inbox"] == 900 - 512
    assert bench.counters["dropped/pmd"] == 299, "all but the one that is left, whether it had room or not"


def test_a_frame_that_still_waits_for_its_amplitude_is_processed_at_the_end():
    bench = Bench()
    bench.send_frame(NOW_NS, amplitude=False)
    (arrived,) = bench.inputs.rest()
    assert arrived.measurement.data.amplitude is None


# --- refused for their stamps ---


@pytest.mark.parametrize(
    ("offset_s", "reason", "words"),
    [
        (-1.1, "late", "late: 1.100 s old, filter.max_delay_s is 1; check the sensor's clock"),
        (-37.0, "late", "late: 37.000 s old"),
        (0.1, "future", "future: 0.100 s ahead of wall time, max_future_s is 0.05; check the sensor's clock"),
        (1e9, "future", "future: 1000000000.000 s ahead"),
    ],
)
def test_a_frame_with_a_wrong_stamp_is_refused_once_with_its_reason(offset_s, reason, words):
    bench = Bench()
    stamp_ns = NOW_NS + round(offset_s * SECOND_NS)
    bench.send_frame(stamp_ns)
    (arrived,) = bench.arrived()
    assert arrived.measurement is None
    assert arrived.stamp_ns == stamp_ns
    assert arrived.reason.startswith(words)
    for topic in (DEPTH, AMPLITUDE):  # a camera_info is valid until another comes
        assert bench.counters[f"rejected/{topic.of('pmd').name}/{reason}"] == 1


@pytest.mark.parametrize("offset_s", [-0.9, 0.04])
def test_what_is_a_little_old_or_ahead_is_taken(offset_s):
    bench = Bench()
    bench.send_frame(NOW_NS + round(offset_s * SECOND_NS))
    assert bench.arrived()[0].measurement is not None


def test_a_stamp_from_the_far_future_does_not_keep_the_frames_after_it_out():
    bench = lidar_bench()
    bench.send_scan(NOW_NS + 10**6 * SECOND_NS)
    bench.send_scan(NOW_NS)
    refused, taken = bench.arrived()
    assert refused.measurement is None
    assert taken.measurement.stamp_ns == NOW_NS


def test_a_frame_that_had_to_wait_is_not_late():
    """Its age counts on arrival: that the last frame's methods took long is not its sensor's fault."""
    bench = Bench()
    bench.send_frame(NOW_NS - SECOND_NS // 2, arrival_ns=NOW_NS)
    assert bench.arrived()[0].measurement is not None


def test_where_the_bus_owns_time_its_clock_judges(monkeypatch):
    monkeypatch.setattr(subscriptions, "_STANDING_S", 0.25)
    bench = Bench(time_source="clock")
    bench.node.clock.set(write_clock(5 * SECOND_NS))
    bench.send_frame(5 * SECOND_NS, arrival_ns=NOW_NS)
    bench.send_frame(7 * SECOND_NS, arrival_ns=NOW_NS)
    refused, taken = bench.arrived()
    assert refused.reason.startswith("future: 2.000 s ahead of clock time")
    assert taken.measurement is not None


@pytest.mark.parametrize("late_s", [0.0, 0.3])
def test_a_clock_message_may_be_handed_over_behind_a_frame_that_was_published_after_it(late_s):
    bench = Bench(time_source="clock")
    bench.send_frame(5 * SECOND_NS)
    late_clock = Timer(late_s, bench.node.clock.set, args=(write_clock(5 * SECOND_NS),))
    late_clock.start()
    (taken,) = bench.arrived()
    late_clock.join()
    assert taken.measurement is not None


def test_a_frame_of_a_stamp_that_is_complete_already_is_a_duplicate():
    bench = lidar_bench()
    for _ in range(2):
        bench.send_scan(NOW_NS)
    refused, taken = bench.arrived()
    assert refused.reason.startswith("duplicate")
    assert taken.measurement is not None
    assert bench.counters["rejected/lidar/points/duplicate"] == 1


def test_a_frame_behind_one_that_is_complete_already_is_passed_over_and_counted():
    bench = Bench()
    bench.send_frame(NOW_NS)
    bench.send_frame(NOW_NS - SECOND_NS // 2)
    (taken,) = bench.arrived()
    assert taken.stamp_ns == NOW_NS
    assert bench.counters["incomplete/pmd"] == 1
    assert bench.node.refused == []


def test_an_amplitude_that_comes_behind_its_frame_is_no_fault():
    bench = Bench()
    bench.send_frame(NOW_NS, amplitude=False)
    bench.send_frame(NOW_NS + 1, amplitude=False)
    image = write_image(NOW_NS, "pmd_optical", np.ones((4, 6), np.uint8), "mono8")
    bench.send(AMPLITUDE.of("pmd"), image)
    assert [frame.measurement.data.amplitude for frame in bench.arrived()] == [None]
    assert not [name for name in bench.counters if name.startswith("rejected")]


# --- told to the operator ---


def told(bench, now_s=3.0):
    """Return level and message of the diagnostics after all frames have been processed."""
    for arrived in bench.arrived():
        accepted = arrived.measurement is not None
        status = EstimatorStatus(
            stamp_ns=arrived.stamp_ns, frame_id="chaser", mode=Mode.TRACKING,
            sensor=arrived.sensor, accepted=accepted, reason=arrived.reason,
        )  # fmt: skip
        bench.inputs.health.judge(arrived, Output(status, None), now_s)
    bench.inputs.health.report(Mode.TRACKING, now_s)
    diagnostic = bench.node.health.diagnostic(0)
    return diagnostic.level, diagnostic.message, diagnostic.values


@pytest.mark.parametrize(
    ("shift_s", "camera_shift_ns", "level", "words"),
    [
        (0.0, 0, Health.OK, "tracking"),
        (37.0, 0, Health.ERROR, "future: 37.000 s ahead of wall time, max_future_s is 0.05; is it TAI?"),
        (-5.0, 0, Health.ERROR, "late: 5.000 s old, filter.max_delay_s is 1; check the sensor's clock"),
        (0.0, 1_000, Health.OK, "tracking"),
        (0.0, None, Health.ERROR, "depth without camera_info, which does not come at all"),
        (0.0, 0, Health.WARN, "frames are identical to the bit; restart the sensor's driver"),
    ],
    ids=["good", "TAI", "slow clock", "camera_info 1 us off", "no camera_info", "frozen"],
)
def test_frames_that_are_not_used_are_told_with_figures_and_remedy(
    shift_s, camera_shift_ns, level, words, caplog
):
    start_s, bench = monotonic(), Bench()
    for number in range(40):
        time_ns, time_s = NOW_NS + number * SECOND_NS // 16, start_s + number / 16
        stamp_ns = time_ns + round(shift_s * SECOND_NS)
        how = {"arrival_ns": time_ns, "arrival_s": time_s}
        if camera_shift_ns is not None:
            camera = write_camera(stamp_ns + camera_shift_ns, "pmd_optical", CAMERA)
            bench.send(CAMERA_INFO.of("pmd"), camera, **how)
        depth_m = DEPTH_M if "identical" in words else DEPTH_M + np.float32(1e-3 * number)
        bench.send(DEPTH.of("pmd"), write_image(stamp_ns, "pmd_optical", depth_m, "32FC1"), **how)
        found = told(bench, time_s)
    assert found[0] == level
    assert words in found[1]
    lines = [record.getMessage() for record in caplog.records if record.getMessage().startswith("pmd: no")]
    assert len(lines) == (level == Health.ERROR)


def test_a_burst_from_a_link_that_held_frames_is_told_as_such_and_not_as_the_clock():
    start_s, bench = monotonic(), Bench()
    for number in range(40):
        stamp_ns = NOW_NS + number * SECOND_NS // 16
        held_s = 0.01 if number < 16 else max(4.0 - number / 16, 0.01)
        how = {
            "arrival_ns": stamp_ns + round(held_s * SECOND_NS),
            "arrival_s": start_s + number / 16 + held_s,
        }
        bench.send(CAMERA_INFO.of("pmd"), write_camera(stamp_ns, "pmd_optical", CAMERA), **how)
        depth_m = DEPTH_M + np.float32(1e-3 * number)
        bench.send(DEPTH.of("pmd"), write_image(stamp_ns, "pmd_optical", depth_m, "32FC1"), **how)
        reasons = [arrived.reason for arrived in bench.arrived()]
        if number >= 16:
            (reason,) = reasons
            assert reason.startswith("late: ")
            assert "it was delayed by" in reason
            assert "clock_offset_s" not in reason


def test_what_a_driver_says_of_ptp_and_trigger_is_repeated():
    bench = Bench()
    sync = SensorSync(ptp="unlocked", ptp_offset_s=0.0012, trigger="hardware", trigger_missed=3)
    for name, ptp in (("driver", "unlocked"), ("estimator", "locked"), ("other", "fine")):
        values = sync.values("pmd") | {"sync/pmd/ptp": ptp, "sync/other/ptp": "locked", "rate_hz": "15"}
        diagnostic = Diagnostic(stamp_ns=1, name=name, level=Health.OK, message="", values=values)
        bench.send(DIAGNOSTICS, write_diagnostics([diagnostic]))
    assert bench.arrived() == []
    start_s = monotonic()
    for number in range(40):
        bench.inputs.health.books["pmd"].note_arrival(start_s + number / 16)
        bench.inputs.health.books["pmd"].use(start_s + number / 16)
    level, message, values = told(bench, start_s + 2.5)
    assert level == Health.WARN
    assert message == "tracking; pmd: its clock is not locked to PTP, it is 0.001200 s off; look at ptp4l"
    assert {name: value for name, value in values.items() if name.startswith("sync/")} == sync.values("pmd")
    assert bench.node.refused == [("diagnostics", "malformed")]


# --- several publishers ---


class Stage:
    """A bench on which frames of several publishers arrive one after the other."""

    def __init__(self):
        self.bench = Bench(sensors=[{"kind": "pmd"}])
        self.now_s = monotonic()
        self.number = 0

    def wait(self, seconds):
        self.now_s += seconds

    def mount(self, by, x_m=0.0):
        mount = make_pose(translation_m=[x_m, -0.05, 0.0])
        message = write_transforms(0, [("chaser", "pmd_optical", mount)])
        self.bench.send(TF_STATIC, message, arrival_s=self.now_s, by=by)

    def frame(self, by, *, tracked=True, camera=CAMERA):
        """Let a frame arrive; return where its camera is mounted, None where it is not used."""
        self.number += 1
        stamp_ns = NOW_NS + self.number * 1_000_000
        self.bench.inputs.pin(tracked)
        how = {"arrival_s": self.now_s, "arrival_ns": stamp_ns}
        self.bench.send_frame(stamp_ns, by=by, camera=camera, **how)
        found = self.bench.arrived()
        self.reason = found[0].reason if found else ""
        return found[0].measurement.T_chaser_sensor.translation[0] if found and not self.reason else None


@pytest.fixture
def stage(monkeypatch):
    stage = Stage()
    monkeypatch.setattr("time.monotonic", lambda: stage.now_s)
    stage.mount(EMULATOR)
    assert stage.frame(EMULATOR) == 0.0
    return stage


def test_a_second_publisher_is_not_used_and_told_with_both_gids(stage):
    stage.mount(DRIVER, x_m=1.0)
    assert stage.frame(DRIVER) is None
    assert stage.frame(EMULATOR) == 0.0
    level, message, values = told(stage.bench, stage.now_s)
    assert level == Health.WARN
    for peer in (EMULATOR, DRIVER):
        assert f"{peer.gid.hex()} (session {peer.session})" in message
        assert peer.gid.hex() in values["publishers/pmd/depth/image_raw"]
        assert peer.gid.hex() in values["publishers/tf_static of pmd_optical"]
    assert ("pmd/depth/image_raw", "second_publisher") in stage.bench.node.refused


@pytest.mark.parametrize("gone", [True, False], ids=["its token is gone", "it is silent for 2 s"])
def test_a_successor_with_the_same_mount_goes_on_without_a_word(stage, gone):
    stage.mount(DRIVER)
    if gone:
        for topic in (TF_STATIC, *(each.of("pmd") for each in (DEPTH, CAMERA_INFO, AMPLITUDE))):
            stage.bench.node.gone(EMULATOR.session, topic)
    else:
        stage.wait(1.9)
        assert stage.frame(DRIVER) is None
        stage.wait(0.2)
    assert stage.frame(DRIVER) == 0.0
    assert stage.frame(EMULATOR) is None
    stage.wait(3.0)
    assert stage.frame(DRIVER) == 0.0
    assert told(stage.bench, stage.now_s)[0] == Health.OK


@pytest.mark.parametrize("alone", [True, False], ids=["it was the last", "another one is there"])
def test_a_publisher_whose_messages_name_no_session_is_gone_with_the_last_token_of_its_topic(alone):
    bench, first, second = Bench(), Peer(b"1" * 16), Peer(b"2" * 16)
    streams = [topic.of("pmd") for topic in (DEPTH, CAMERA_INFO, AMPLITUDE)]
    for topic in streams:
        for session in ("one",) if alone else ("one", "other"):
            bench.node.came(session, topic)
    bench.send_frame(NOW_NS, by=first)
    assert not bench.arrived()[0].reason
    for topic in streams:
        bench.node.gone("one", topic)
    bench.send_frame(NOW_NS + 1, by=second)
    assert [not frame.reason for frame in bench.arrived()] == ([True] if alone else [])


@pytest.mark.parametrize("successor", [EMULATOR, DRIVER], ids=["the same publisher", "a successor"])
def test_another_mount_is_not_used_while_tracked_until_a_reset(stage, successor):
    if successor != EMULATOR:
        stage.wait(2.5)
    stage.mount(successor, x_m=1.0)
    assert stage.frame(successor) is None
    assert stage.reason.startswith("other_setup: the mount has moved by 1.000 m and 0.00 deg since tracking")
    assert successor.gid.hex() in stage.reason
    stage.bench.send_frame(NOW_NS + 10**9, arrival_ns=NOW_NS + 10**9, by=successor, arrival_s=stage.now_s)
    level, message, _ = told(stage.bench, stage.now_s)
    assert level == Health.ERROR
    assert "the mount has moved by 1.000 m" in message
    stage.bench.inputs.request_reset(ResetRequest())
    stage.number += 2000
    assert stage.frame(successor) == 1.0


def test_another_mount_is_used_before_anything_is_tracked(stage):
    stage.mount(EMULATOR, x_m=1.0)
    assert stage.frame(EMULATOR, tracked=False) == 1.0


def test_a_mount_that_is_put_right_is_used_again(stage):
    stage.mount(EMULATOR, x_m=1.0)
    assert stage.frame(EMULATOR) is None
    stage.mount(EMULATOR)
    assert stage.frame(EMULATOR) == 0.0


def test_a_camera_info_that_was_sent_once_is_held_as_long_as_frames_come(stage):
    other = CAMERA.model_copy(update={"fx": 6.0})
    for _ in range(5):
        stage.wait(1.0)
        assert stage.frame(EMULATOR, camera=None) == 0.0
        stage.mount(DRIVER)
        assert stage.frame(DRIVER, camera=other) is None
    assert ("pmd/camera_info", "second_publisher") in stage.bench.node.refused
    stage.wait(3.5)
    assert stage.frame(DRIVER) == 0.0


def test_another_lens_is_not_used_while_tracked(stage):
    other = CAMERA.model_copy(update={"fx": 6.0})
    assert [stage.frame(EMULATOR, camera=other) for _ in range(30)] == [None] * 30
    assert "fx is 6, not 5 as in the frames before; `reset` the estimator" in stage.reason
    stage.bench.inputs.request_reset(ResetRequest())
    assert stage.frame(EMULATOR, camera=other) == 0.0


def test_another_info_is_not_used_while_tracked_but_another_exposure_is(stage):
    def announce(frequency_hz, exposure_s):
        info = PmdInfo(
            modulation_frequency_hz=np.array([frequency_hz]), integration_time_s=exposure_s,
            electrons_per_count=1.0, saturation_count=100.0,
        )  # fmt: skip
        stage.bench.send(PMD_INFO.of("pmd"), write_pmd_info(0, "pmd_optical", info), by=EMULATOR)

    announce(2e7, 1e-3)
    assert stage.frame(EMULATOR) == 0.0
    announce(2e7, 2e-3)
    assert stage.frame(EMULATOR) == 0.0
    announce(3e7, 2e-3)
    assert stage.frame(EMULATOR) is None
    assert "modulation_frequency_hz of the sensor's info has changed from 2e+07 to 3e+07" in stage.reason
    assert stage.bench.inputs.infos["pmd"].modulation_frequency_hz == [2e7]


FIRST, SECOND = Peer(b"1" * 16), Peer(b"2" * 16)
"""Publishers whose messages name no session, as those of rmw_zenoh."""


@pytest.fixture
def unnamed(stage):
    """Return a stage whose first publisher names no session."""
    stage.bench.inputs.request_reset(ResetRequest())
    stage.mount(FIRST)
    for topic in (TF_STATIC, *(each.of("pmd") for each in (DEPTH, CAMERA_INFO, AMPLITUDE))):
        stage.bench.node.gone(EMULATOR.session, topic)
    stage.wait(2.5)
    assert stage.frame(FIRST) == 0.0
    return stage


@pytest.mark.parametrize("first_frames", [0, 3], ids=["before its frames", "after some frames"])
def test_the_mount_of_a_successor_that_names_no_session_is_its_own(unnamed, first_frames):
    """As where a driver is started again with a mount that was put right."""
    unnamed.wait(2.5)
    for _ in range(first_frames):
        assert unnamed.frame(SECOND, tracked=False) == 0.0
    unnamed.mount(SECOND, x_m=1.0)
    assert unnamed.frame(SECOND, tracked=False) == 1.0
    assert told(unnamed.bench, unnamed.now_s)[0] == Health.OK


def test_another_mount_of_a_successor_that_names_no_session_is_not_used_while_tracked(unnamed):
    unnamed.wait(2.5)
    unnamed.mount(SECOND, x_m=1.0)
    assert unnamed.frame(SECOND) is None
    assert unnamed.reason.startswith("other_setup: the mount has moved by 1.000 m")
    unnamed.bench.inputs.request_reset(ResetRequest())
    assert unnamed.frame(SECOND) == 1.0


def test_another_mount_beside_a_publisher_that_names_no_session_is_not_used(unnamed):
    unnamed.mount(SECOND, x_m=1.0)
    assert unnamed.frame(SECOND, tracked=False) is None
    assert unnamed.frame(FIRST, tracked=False) == 0.0
    level, message, _ = told(unnamed.bench, unnamed.now_s)
    assert (level, "two publishers" in message) == (Health.WARN, True)


def test_the_lens_of_a_successor_that_names_no_session_is_its_own(unnamed):
    other = CAMERA.model_copy(update={"fx": 6.0})
    for _ in range(3):
        unnamed.wait(2.5)
        unnamed.frame(SECOND, tracked=False, camera=None)
    unnamed.frame(SECOND, tracked=False, camera=other)
    assert "second_publisher" not in unnamed.reason
    assert ("pmd/camera_info", "second_publisher") not in unnamed.bench.node.refused
    assert unnamed.bench.inputs.health.rivals == []


def test_a_first_frame_that_overtakes_its_camera_info_does_not_bind_that_of_the_driver_before(unnamed):
    """The driver before had no mount, so that none of its frames was used."""
    unnamed.wait(2.5)
    for _ in range(3):
        unnamed.wait(0.1)
        unnamed.bench.send_frame(
            NOW_NS + unnamed.number * 1_000_000 + 1, by=SECOND, frame_id="nowhere", arrival_s=unnamed.now_s
        )
        unnamed.number += 1
        assert unnamed.bench.arrived()[0].refused == "unknown_frame"
    unnamed.wait(2.5)
    [lens(unnamed, THIRD) for _ in range(3)]
    used = [lens(unnamed, THIRD, camera=OTHER_LENS) for _ in range(30)]
    assert used[-1] == 6.0
    assert ("pmd/camera_info", "second_publisher") not in unnamed.bench.node.refused


THIRD = Peer(b"3" * 16)
OTHER_LENS = CAMERA.model_copy(update={"fx": 6.0})


def send_camera(stage, by, camera=OTHER_LENS):
    """Let a camera_info come alone."""
    stage.number += 1
    message = write_camera(NOW_NS + stage.number * 1_000_000, "c", camera)
    stage.bench.send(CAMERA_INFO.of("pmd"), message, by=by, arrival_s=stage.now_s)
    assert stage.bench.arrived() == []


def lens(stage, by, *, camera=None, tracked=False):
    """Let a frame come; return the focal length with which it is used, None where it is not used."""
    stage.number += 1
    stamp_ns = NOW_NS + stage.number * 1_000_000
    stage.bench.inputs.pin(tracked)
    stage.bench.send_frame(stamp_ns, by=by, camera=camera, arrival_s=stage.now_s, arrival_ns=stamp_ns)
    found = stage.bench.arrived()
    return found[0].measurement.data.camera.fx if found and found[0].measurement is not None else None


def test_a_camera_info_that_came_once_while_its_topic_was_held_counts_with_its_publishers_frames(unnamed):
    """As of a driver that is started again at once: its camera_info does not come a second time."""
    unnamed.wait(1.0)
    send_camera(unnamed, SECOND)
    assert lens(unnamed, SECOND) is None, "the publisher before is not silent for 2 s"
    unnamed.wait(1.5)
    assert [lens(unnamed, SECOND) for _ in range(30)][-1] == 6.0
    assert lens(unnamed, SECOND) == 6.0
    assert unnamed.bench.inputs.health.rivals == []


def test_a_kept_camera_info_is_not_used_with_the_frames_of_the_holder(unnamed):
    send_camera(unnamed, SECOND)
    used = []
    for _ in range(10):
        unnamed.wait(1.0)
        used.append(lens(unnamed, FIRST))
    assert set(used[3:]) == {5.0}, "the first ones wait for a camera_info of their own"
    assert ("pmd/camera_info", "second_publisher") in unnamed.bench.node.refused


def test_of_drivers_that_started_one_after_the_other_the_last_ones_camera_info_counts(unnamed):
    for peer, fx in ((SECOND, 6.0), (THIRD, 7.0)):
        unnamed.wait(0.5)
        send_camera(unnamed, peer, CAMERA.model_copy(update={"fx": fx}))
    unnamed.wait(2.0)
    assert [lens(unnamed, THIRD) for _ in range(30)][-1] == 7.0


def test_the_own_camera_info_of_a_third_driver_goes_before_one_that_was_kept(unnamed):
    send_camera(unnamed, SECOND)
    unnamed.wait(2.5)
    send_camera(unnamed, THIRD, CAMERA.model_copy(update={"fx": 7.0}))
    assert [lens(unnamed, THIRD) for _ in range(30)][-1] == 7.0


def test_a_kept_camera_info_does_not_keep_that_of_a_third_driver_out(unnamed):
    send_camera(unnamed, SECOND)
    unnamed.wait(2.5)
    assert [lens(unnamed, THIRD) for _ in range(30)][-1] == 6.0, "the newest that is known"
    send_camera(unnamed, THIRD, CAMERA.model_copy(update={"fx": 7.0}))
    assert [lens(unnamed, THIRD) for _ in range(30)][-1] == 7.0


def test_a_kept_camera_info_of_a_publisher_that_is_gone_does_not_count(stage):
    gone = Peer(b"g" * 16, "g0")
    send_camera(stage, gone)
    stage.bench.node.gone(gone.session, CAMERA_INFO.of("pmd"))
    send_camera(stage, DRIVER, CAMERA.model_copy(update={"fx": 7.0}))
    stage.wait(2.5)
    assert [lens(stage, DRIVER) for _ in range(30)][-1] == 7.0


def test_another_kept_lens_is_not_used_while_tracked(unnamed):
    send_camera(unnamed, SECOND)
    unnamed.wait(2.5)
    assert [lens(unnamed, SECOND, tracked=True) for _ in range(30)] == [None] * 30


def test_what_is_kept_is_bounded(unnamed):
    for number in range(1000):
        send_camera(unnamed, Peer(number.to_bytes(16, "big")))
    assert sum(map(len, unnamed.bench.inputs._kept._kept.values())) <= 8


def test_an_info_that_came_once_just_after_the_driver_before_counts_with_its_publishers_scans(monkeypatch):
    bench, now_s = lidar_bench(), [1000.0]
    monkeypatch.setattr("time.monotonic", lambda: now_s[0])

    def scan(by):
        stamp_ns = NOW_NS + round((now_s[0] - 1000.0) * SECOND_NS)
        fields = {name: values + np.float32(1e-3 * now_s[0]) for name, values in CLOUD.items()}
        bench.send_scan(stamp_ns, fields, by=by, arrival_ns=stamp_ns, arrival_s=now_s[0])
        used = [frame.measurement for frame in bench.arrived() if frame.measurement is not None]
        return bench.inputs.infos["lidar"].azimuth_rad if used else None

    def announce(by, azimuth_rad):
        info = LidarInfo(
            azimuth_rad=np.array(azimuth_rad), elevation_rad=np.array([0.0, 0.1]), scan_time_s=0.1,
            sigma_range_m=0.01,
        )  # fmt: skip
        bench.send(LIDAR_INFO.of("lidar"), write_lidar_info(0, "lidar", info), by=by, arrival_s=now_s[0])

    announce(FIRST, [0.0, 0.1, 0.2])
    np.testing.assert_array_equal(scan(FIRST), [0.0, 0.1, 0.2])
    now_s[0] += 0.5
    announce(SECOND, [0.1, 0.3, 0.5])
    assert scan(SECOND) is None, "the publisher before is not silent for 2 s"
    now_s[0] += 3.0
    np.testing.assert_array_equal(scan(SECOND), [0.1, 0.3, 0.5])


def test_a_reset_may_name_the_gid_to_keep(stage):
    stage.mount(DRIVER, x_m=1.0)
    assert stage.frame(DRIVER) is None
    with pytest.raises(RefusedError, match=f"known are {DRIVER.gid.hex()} .*{EMULATOR.gid.hex()}"):
        stage.bench.inputs.request_reset(ResetRequest(keep_gid="0" * 32))
    stage.bench.inputs.request_reset(ResetRequest(keep_gid=DRIVER.gid.hex()))
    assert stage.frame(EMULATOR) is None
    assert stage.frame(DRIVER) == 1.0


# --- refused for what they hold ---


def wrong_camera():
    return write_camera(NOW_NS, "pmd_optical", CAMERA.model_copy(update={"width": 7}))


def with_field(message, **changes):
    for name, value in changes.items():
        setattr(message, name, value)
    return message


def image(array, encoding):
    return write_image(NOW_NS, "pmd_optical", array, encoding)


@pytest.mark.parametrize(
    ("topic", "message", "reason"),
    [
        (DEPTH, image(np.full((4, 6), np.nan, np.float32), "32FC1"), "not_finite"),
        (DEPTH, image(np.ones((4, 6), np.uint8), "mono8"), "wrong_type"),
        (DEPTH, image(np.ones((4, 5), np.float32), "32FC1"), "wrong_size"),
        (DEPTH, with_field(image(DEPTH_M, "32FC1"), data=np.zeros(95, np.uint8)), "wrong_size"),
        (DEPTH, with_field(image(DEPTH_M, "32FC1"), encoding="rgb8"), "wrong_type"),
        (AMPLITUDE, image(np.ones((3, 6), np.uint16), "mono16"), "wrong_size"),
        (AMPLITUDE, image(np.ones((4, 6, 4), np.uint16), "16UC4"), "wrong_type"),
        (CAMERA_INFO, with_field(wrong_camera(), k=np.full(9, np.nan)), "not_finite"),
        (CAMERA_INFO, with_field(wrong_camera(), k=np.zeros(9)), "malformed"),
        (CAMERA_INFO, with_field(wrong_camera(), d=np.ones(8)), "wrong_size"),
        (CAMERA_INFO, with_field(wrong_camera(), distortion_model="double_sphere"), "wrong_type"),
    ],
)
def test_a_part_that_cannot_be_used_is_counted_on_its_own_topic(topic, message, reason):
    bench = Bench()
    parts = {
        CAMERA_INFO: write_camera(NOW_NS, "pmd_optical", CAMERA),
        DEPTH: image(DEPTH_M, "32FC1"),
        AMPLITUDE: image(np.ones((4, 6), np.uint16), "mono16"),
    }
    for part, sent in (parts | {topic: message}).items():
        bench.send(part.of("pmd"), with_field(sent))
    (arrived,) = bench.arrived()
    assert arrived.measurement is None
    assert arrived.reason.startswith(reason)
    assert bench.node.refused == [(topic.of("pmd").name, reason)]


def test_images_that_do_not_fit_their_camera_are_counted_as_of_the_wrong_size():
    bench = Bench()
    bench.send(DEPTH.of("pmd"), image(DEPTH_M, "32FC1"))
    bench.send(AMPLITUDE.of("pmd"), image(np.ones((4, 6), np.uint16), "mono16"))
    bench.send(CAMERA_INFO.of("pmd"), wrong_camera())
    (arrived,) = bench.arrived()
    assert arrived.reason == (
        "wrong_size: the depth image is 6 x 4 pixels, camera_info says 7 x 4; let its driver send the "
        "camera_info of the depth image, as it is scaled or cropped"
    )


@pytest.mark.parametrize("kept", [0, 3, 11])
def test_what_is_too_short_to_hold_a_stamp_is_counted_without_a_frame(kept):
    bench = Bench()
    depth = image(DEPTH_M, "32FC1")
    bench.send(DEPTH.of("pmd"), depth, damage=lambda payload: payload[:kept])
    assert bench.arrived() == []
    assert bench.node.refused == [("pmd/depth/image_raw", "malformed")]


@pytest.mark.parametrize(("seconds", "nanoseconds"), [(-1, 0), (5, 1_000_000_000), (-(2**31), 2**32 - 1)])
def test_a_stamp_that_is_none_is_counted_without_a_frame(seconds, nanoseconds):
    bench = lidar_bench()
    cloud = write_points(NOW_NS, "lidar", CLOUD)
    cloud.header.stamp.sec, cloud.header.stamp.nanosec = seconds, nanoseconds
    bench.send(POINTS.of("lidar"), cloud)
    assert bench.arrived() == []
    assert bench.node.refused == [("lidar/points", "malformed")]


def test_a_truncated_part_is_refused_with_the_stamp_that_it_still_has():
    bench = lidar_bench()
    bench.send_scan(NOW_NS, damage=lambda payload: payload[:-8])
    (arrived,) = bench.arrived()
    assert (arrived.stamp_ns, arrived.reason.split(":")[0]) == (NOW_NS, "malformed")


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"data": np.zeros(10, np.uint8)}, "wrong_size"),
        ({"row_step": 4000}, "wrong_size"),
        ({"width": 0}, "empty"),
        ({"height": 0}, "empty"),
        ({"fields": []}, "wrong_type"),
        ({"point_step": 0}, "wrong_type"),
        ({"data": np.full(24, np.nan, np.float32).view(np.uint8)}, "not_finite"),
    ],
)
def test_a_cloud_that_cannot_be_used_is_refused(changes, reason):
    bench = lidar_bench()
    bench.send(POINTS.of("lidar"), with_field(write_points(NOW_NS, "lidar", CLOUD), **changes))
    (arrived,) = bench.arrived()
    assert arrived.measurement is None
    assert bench.node.refused == [("lidar/points", reason)]


@pytest.mark.parametrize("frame_id", ["", "somewhere"])
def test_a_frame_without_a_chain_to_the_chaser_is_refused(frame_id):
    bench = Bench(sensors=[{"kind": "pmd"}])
    bench.send_frame(NOW_NS, frame_id=frame_id)
    (arrived,) = bench.arrived()
    assert arrived.reason.startswith(f"unknown_frame: no chain from {frame_id!r} to 'chaser'")
    assert bench.node.refused == [("pmd/depth/image_raw", "unknown_frame")]


def test_a_mount_that_is_told_in_two_ways_is_refused():
    bench = Bench()
    bench.send(
        TF_STATIC, write_transforms(0, [("chaser", "pmd_optical", make_pose(translation_m=[1, 0, 0]))])
    )
    bench.send_frame(NOW_NS)
    (arrived,) = bench.arrived()
    assert "differ" in arrived.reason


def test_transforms_that_are_none_are_counted():
    bench = Bench()
    message = write_transforms(0, [("chaser", "pmd_optical", MOUNT)])
    message.transforms[0].transform.rotation.w = 0.0
    bench.send(TF_STATIC, message)
    assert bench.arrived() == []
    assert bench.node.refused == [("tf_static", "malformed")]


def test_good_frames_follow_upon_bad_ones():
    bench = Bench()
    bench.send(DEPTH.of("pmd"), image(DEPTH_M, "32FC1"), damage=lambda payload: payload[:5])
    bench.send(CAMERA_INFO.of("pmd"), wrong_camera())
    bench.send_frame(NOW_NS - 40 * SECOND_NS)
    bench.send_frame(NOW_NS + 40 * SECOND_NS)
    bench.send_frame(NOW_NS + 1)
    *refused, taken = bench.arrived()
    assert [frame.measurement for frame in refused] == [None] * 2
    assert taken.measurement.stamp_ns == NOW_NS + 1


# --- the LIDAR's own account of itself ---


def lidar_info(**changes):
    info = {
        "azimuth_rad": [-0.1, 0.0, 0.1],
        "elevation_rad": [0.0, 0.1],
        "scan_time_s": 0.1,
        "sigma_range_m": 0.02,
    }
    return write_lidar_info(0, "lidar", LidarInfo(**(info | changes)))


def test_the_scan_pattern_comes_from_the_latched_info():
    bench = lidar_bench()
    bench.send(LIDAR_INFO.of("lidar"), lidar_info())
    bench.arrived()
    np.testing.assert_array_equal(bench.inputs.infos["lidar"].azimuth_rad, [-0.1, 0.0, 0.1])


def test_a_configured_scan_pattern_counts_until_the_lidar_publishes_its_own():
    angles = {"azimuth_rad": [-0.2, 0.0, 0.2], "elevation_rad": [0.0, 0.2]}
    bench = Bench(sensors=[{"kind": "lidar", "T_chaser_sensor": {}, **angles}])
    assert bench.inputs.infos["lidar"].azimuth_rad.tolist() == [-0.2, 0.0, 0.2]
    bench.send(LIDAR_INFO.of("lidar"), lidar_info())
    bench.arrived()
    assert bench.inputs.infos["lidar"].azimuth_rad.tolist() == [-0.1, 0.0, 0.1]


def test_scans_whose_rows_are_azimuth_are_turned():
    bench = lidar_bench()
    bench.send(LIDAR_INFO.of("lidar"), lidar_info(rows_are_elevation=False))
    bench.send_scan(NOW_NS, {name: values.T.copy() for name, values in CLOUD.items()})
    scan = bench.arrived()[0].measurement.data
    np.testing.assert_array_equal(scan.points_m[..., 0], CLOUD["x"])
    np.testing.assert_array_equal(scan.intensity, CLOUD["intensity"])


def test_an_info_without_a_pattern_is_no_pattern():
    bench = lidar_bench()
    bench.send(LIDAR_INFO.of("lidar"), lidar_info(azimuth_rad=[], elevation_rad=[]))
    assert bench.arrived() == []
    assert bench.inputs.infos["lidar"] is None


def test_a_pattern_that_is_not_finite_is_counted():
    bench = lidar_bench()
    message = lidar_info()
    message.azimuth_rad = np.array([0.0, np.nan])
    bench.send(LIDAR_INFO.of("lidar"), message)
    assert bench.arrived() == []
    assert bench.node.refused == [("lidar/info", "not_finite")]
    assert bench.inputs.infos["lidar"] is None


# --- frames of another camera ---


def test_a_frame_of_another_camera_is_refused_by_the_field_that_differs():
    bench = Bench()
    other = CAMERA.model_copy(update={"fx": 7.5})
    for number, camera in enumerate((CAMERA, other, CAMERA)):
        bench.send_frame(NOW_NS + number, camera=camera)
        arrived = bench.arrived()[0]
        assert (arrived.measurement is None) == (camera is other)
    assert bench.node.refused == [("pmd/camera_info", "other_camera")]


def test_a_camera_that_has_changed_is_accepted_in_the_end():
    bench = Bench()
    bench.send_frame(NOW_NS)
    bench.arrived()
    changed = CAMERA.model_copy(update={"distortion": np.array([0.1, 0.0, 0.0, 0.0, 0.0])})
    taken = []
    for number in range(1, 14):
        bench.send_frame(NOW_NS + number, camera=changed)
        taken.append(bench.arrived()[0].measurement is not None)
    assert taken == [False] * 10 + [True] * 3


# --- the camera's own account of itself ---

PMD = PmdInfo(
    modulation_frequency_hz=np.array([20.013e6]),
    integration_time_s=0.016,
    electrons_per_count=40.0,
    saturation_count=3750.0,
)


def test_a_frame_carries_what_its_camera_says_of_itself():
    bench = Bench()
    bench.send_frame(NOW_NS - 1)
    assert bench.arrived()[0].measurement.data.info is None
    bench.send(PMD_INFO.of("pmd"), write_pmd_info(0, "pmd_optical", PMD))
    bench.send_frame(NOW_NS)
    assert bench.arrived()[0].measurement.data.info.modulation_frequency_hz == [20.013e6]


def test_a_camera_without_a_positive_frequency_is_not_believed():
    bench = Bench()
    message = write_pmd_info(0, "pmd_optical", PMD)
    message.modulation_frequency_hz = np.array([0.0])
    bench.send(PMD_INFO.of("pmd"), message)
    assert bench.arrived() == []
    assert bench.node.refused == [("pmd/info", "malformed")]
    assert bench.inputs.infos["pmd"] is None


# --- drivers that do not keep to the ICD ---


def test_a_camera_info_once_a_second_or_from_before_is_enough():
    bench = Bench()
    assert [topic.name for topic, past in bench.node.past.items() if past] == ["pmd/camera_info"]
    bench.send(CAMERA_INFO.of("pmd"), write_camera(NOW_NS - 900 * SECOND_NS, "pmd_optical", CAMERA))
    found = []
    for number in range(5):
        stamp_ns = NOW_NS - SECOND_NS // 2 + number * 10**7
        depth_m = DEPTH_M + np.float32(1e-3 * number)
        bench.send(DEPTH.of("pmd"), write_image(stamp_ns, "pmd_optical", depth_m, "32FC1"))
        found += bench.arrived()
    assert len(found) == 4  # the last one waits for its amplitude
    assert all(arrived.measurement is not None for arrived in found)


def test_without_a_camera_info_no_frame_is_complete():
    bench = Bench()
    for number in range(12):
        stamp_ns = NOW_NS - SECOND_NS // 2 + number * 10**7
        bench.send(DEPTH.of("pmd"), write_image(stamp_ns, "pmd_optical", DEPTH_M, "32FC1"))
    assert bench.arrived() == []
    assert bench.counters["incomplete/pmd"] == 4


FOREIGN = {
    "topics": {"depth": "depth/image", "camera_info": "/other/info", "amplitude": "ir/image"},
    "namespace": "robot/cam",
    "stamp": "start",
    "duration_s": 0.02,
    "clock_offset_s": 37.0,
    "pair_within_s": 0.002,
}


def test_topics_stamps_and_pairing_of_a_driver_are_configuration():
    bench = Bench(sensors=[{"kind": "pmd", "name": "front", "source": FOREIGN, "T_chaser_sensor": {}}])
    names = {topic.name: topic for topic in bench.node.sinks}
    sent_ns = NOW_NS + 37 * SECOND_NS
    bench.send(names["other/info"], write_camera(sent_ns, "c", CAMERA))
    bench.send(names["robot/cam/depth/image"], write_image(sent_ns, "c", DEPTH_M, "32FC1"))
    image = np.arange(24, dtype=np.uint16).reshape(4, 6)
    bench.send(names["robot/cam/ir/image"], write_image(sent_ns + 1_500_000, "c", image, "mono16"))
    (arrived,) = bench.arrived()
    assert (arrived.sensor, arrived.stamp_ns) == ("front", NOW_NS + 10_000_000)
    assert arrived.measurement.data.amplitude is not None
    assert bench.node.health.diagnostic(0).values["stamp_age_s/front"] == "-0.01"


@pytest.mark.parametrize(
    ("source", "text"),
    [
        ({"topics": {"depth": "d"}}, "'camera_info' is missing"),
        ({"topics": {"depth": "d", "camera_info": "c", "infra": "i"}}, "'infra' is no part of a PMD camera"),
        ({"topics": {"depth": "d", "camera_info": "d"}}, "depth and camera_info have the topic 'd'"),
    ],
)
def test_topics_that_make_no_frame_are_told(source, text):
    with pytest.raises(ConfigurationError, match=text):
        Bench(sensors=[{"kind": "pmd", "source": source}])


def test_two_sensors_of_the_same_topics_are_told():
    """As where a preset is copied for a second camera, and its namespace is not changed."""
    sensors = [{"kind": "pmd", "name": name, "source": FOREIGN} for name in ("left", "right")]
    with pytest.raises(
        ConfigurationError, match=r"right: source\.topics: .* is already the depth of the sensor left"
    ):
        Bench(sensors=sensors)


def told_of_scans(late_s, *, last_s=0.05, source=None):
    """Return the state of a LIDAR whose stamps are late, after six scans, 10 ms of read-out and link each."""
    source = {"source": source or {}}
    bench = Bench(sensors=[{"kind": "lidar", "T_chaser_sensor": {}, **source}])
    azimuth_rad, elevation_rad = np.linspace(-0.1, 0.1, 3), np.linspace(-0.1, 0.1, 2)
    said = LidarInfo(
        azimuth_rad=azimuth_rad, elevation_rad=elevation_rad, scan_time_s=last_s + 0.05, sigma_range_m=0.02
    )
    bench.send(LIDAR_INFO.of("lidar"), write_lidar_info(0, "lidar", said))
    book = bench.inputs.health.books["lidar"]
    for number in range(6):
        measured_ns = NOW_NS + number * SECOND_NS
        noise_m = np.float32(1e-3 * number)
        fields = {name: values + noise_m for name, values in CLOUD.items()}
        fields["t"] = np.linspace(-0.05, last_s, 6, dtype=np.float32).reshape(2, 3)
        arrival_ns = measured_ns + round((last_s + 0.01) * 1e9)
        bench.send_scan(
            measured_ns + round(late_s * 1e9), fields, arrival_ns=arrival_ns, arrival_s=float(number)
        )
        for arrived in bench.arrived():
            assert arrived.measurement is not None, arrived.reason
            book.use(float(number))
    return book.state(5.5), bench.node.health.diagnostic(0).values


@pytest.mark.parametrize(
    ("late_s", "level", "words"),
    [
        (0.0, Health.OK, ""),
        (
            0.05,
            Health.WARN,
            "lidar: its stamps are at least 0.040 s late: frames arrive before their last poi",
        ),
        (0.1, Health.WARN, "its stamps are at least 0.090 s late"),
        (-0.05, Health.OK, ""),
        (-0.3, Health.WARN, "lidar: its stamps may be up to 0.310 s early: all frames arrive at least that"),
    ],
)
def test_an_offset_of_a_lidars_stamps_that_no_limit_refuses_is_told_as_far_as_arrivals_show_it(
    late_s, level, words
):
    state, values = told_of_scans(late_s)
    assert state.level == level, state.text
    assert words in state.text
    assert float(values["arrives_after_s/lidar"]) == pytest.approx(0.01 - late_s, abs=1e-6)


def test_a_driver_that_is_known_to_be_slow_is_not_told_again():
    assert told_of_scans(-0.3, source={"arrives_within_s": 0.35})[0].level == Health.OK


def test_the_time_to_the_end_of_a_scan_is_written_to_the_log_once(caplog):
    with caplog.at_level("INFO"):
        told_of_scans(0.0)
    lines = [record.getMessage() for record in caplog.records if "frames arrive" in record.getMessage()]
    assert lines == ["lidar: frames arrive 0.010 s after their last point"]


def test_drift_of_a_clock_is_seen_through_the_delays():
    watch, rng = StampWatch(), np.random.default_rng(1)
    for second in np.arange(0.0, 30.0, 0.05):
        delay_s = 0.003 + rng.exponential(0.004)
        watch.add(round((100.0 + second * (1.0 + 50e-6) - delay_s) * 1e9), round((100.0 + second) * 1e9))
    assert watch.drift_ppm == pytest.approx(50.0, abs=15.0)
    assert watch.age_s == pytest.approx(0.003 - 29 * 50e-6, abs=0.001)


def test_a_sensor_that_never_sends_is_told_with_what_is_awaited_and_what_is_published_instead():
    bench = Bench()

    def said() -> str:
        bench.arrived()
        return bench.inputs.health.books["pmd"].state(monotonic() + 5.0).text

    awaited = DEPTH.of("pmd").name
    assert f"{awaited} is awaited, and no sensor's topic is published" in said()
    other = DEPTH.of("front")
    bench.node.came("one", other)
    bench.node.came("one", DIAGNOSTICS)
    assert f"{awaited} is awaited, published are {other.name}; set" in said()
    bench.node.came("one", DEPTH.of("pmd"))
    assert f"{awaited} has a publisher that sends nothing" in said()
    bench.node.gone("one", other)
    bench.node.gone("one", DEPTH.of("pmd"))
    assert "no sensor's topic is published" in said()
    endpoint = "MP/%/%/cam/%cam%depth%image_raw/sensor_msgs::msg::dds_::Image_/RIHS01_0/::,1:,:,:,,"
    key = f"@ros2_lv/7/5e55/0/2/{endpoint}"
    bench.node.hears(key, True)
    assert "/cam/depth/image_raw is published in ROS domain 7: give driver and estimator the same" in said()
    bench.node.hears(key, False)
    assert "ROS domain" not in said()
    bench.send_frame(NOW_NS)
    assert "awaited" not in said()


def test_the_images_of_an_estimator_are_no_sensor_that_sends_instead():
    bench = Bench()
    bench.node.came("own", CONTRADICTION)
    bench.arrived()
    assert "no sensor's topic is published" in bench.inputs.health.books["pmd"].state(monotonic() + 5.0).text


# --- refused messages that are no frames, in the message of the diagnostics ---


def message_of(bench, now_s=1.0):
    """Return level and message of the estimator's diagnostics at a time."""
    bench.arrived()
    bench.inputs.health._next_s = now_s  # the next update is due
    bench.inputs.health.report(Mode.TRACKING, now_s)
    diagnostic = bench.node.health.diagnostic(NOW_NS)
    return diagnostic.level, diagnostic.message


def degrees():
    message = lidar_info()
    message.azimuth_rad = np.array([-14.0, 0.0, 14.0])
    return message


def test_a_refused_info_stands_in_the_message_until_a_right_one_comes():
    bench = lidar_bench()
    bench.send(LIDAR_INFO.of("lidar"), degrees(), by=DRIVER)
    level, message = message_of(bench)
    assert level == Health.WARN
    assert "lidar/info is refused, malformed: azimuth_rad is -14" in message
    assert "are they degrees?" in message
    assert "correct its publisher" in message
    assert "lidar/info" in message_of(bench, now_s=1000.0)[1]  # a latched message stands
    bench.send(LIDAR_INFO.of("lidar"), lidar_info(), by=DRIVER)
    assert message_of(bench) == (Health.OK, "tracking")


def test_a_refused_info_is_forgotten_when_its_publisher_leaves():
    bench = lidar_bench()
    bench.send(LIDAR_INFO.of("lidar"), degrees(), by=DRIVER)
    assert message_of(bench)[0] == Health.WARN
    bench.node.gone(DRIVER.session, LIDAR_INFO.of("lidar"))
    assert message_of(bench) == (Health.OK, "tracking")


def test_a_refused_mount_stands_in_the_message():
    bench = Bench()
    message = write_transforms(0, [("chaser", "pmd_optical", MOUNT)])
    message.transforms[0].transform.rotation.w = 3.0
    bench.send(TF_STATIC, message, by=DRIVER)
    level, text = message_of(bench)
    assert level == Health.WARN
    assert "tf_static is refused, malformed: " in text


def test_a_refused_part_is_told_for_some_seconds():
    bench = Bench()
    message = write_image(NOW_NS - 9 * SECOND_NS, "c", np.ones((4, 6), np.uint16), "mono16")
    bench.send(AMPLITUDE.of("pmd"), message, arrival_s=1.0)
    level, text = message_of(bench)
    assert level == Health.WARN
    assert "pmd/amplitude/image_raw is refused, late: 9.000 s old" in text
    assert "amplitude" not in message_of(bench, now_s=20.0)[1]


def test_a_sensor_whose_messages_are_all_refused_is_not_said_to_be_silent():
    bench = Bench()
    bench.send(
        DEPTH.of("pmd"), write_image(NOW_NS, "c", DEPTH_M, "32FC1"), damage=lambda payload: payload[:6]
    )
    later_s = monotonic() + 5.0
    _, text = message_of(bench, later_s)
    assert "messages on pmd/depth/image_raw come and are refused" in text


def test_a_clock_that_drifts_beyond_what_is_declared_is_told_although_each_frame_is_used():
    bench, start_s = Bench(), monotonic()
    for number in range(180):
        time_ns = NOW_NS + number * SECOND_NS // 2
        how = {"arrival_ns": time_ns, "arrival_s": start_s + number / 2.0}
        bench.send_frame(NOW_NS + round((1.0 - 4e-4) * (time_ns - NOW_NS)), **how)
        for arrived in bench.arrived():
            bench.inputs.health.books[arrived.sensor].use(how["arrival_s"])
        if number == 60:
            assert message_of(bench, how["arrival_s"]) == (Health.OK, "tracking")
    level, message = message_of(bench, how["arrival_s"])
    assert level == Health.WARN
    assert "pmd: its clock runs 400 ppm too slow: its stamps have moved by 32.0 ms in 80 s" in message


def test_frames_of_a_clock_that_is_set_back_are_refused_from_the_first_one_on_until_a_reset():
    bench, start_s = lidar_bench(), monotonic()

    def scan(number, moved_s=0.0):
        due_ns = NOW_NS + number * SECOND_NS // 10
        fields = {name: values + np.float32(1e-3 * number) for name, values in CLOUD.items()}
        when = {"arrival_ns": due_ns + 10_000_000, "arrival_s": start_s + 0.1 * number}
        bench.send_scan(due_ns + round(moved_s * SECOND_NS), fields, **when)
        (arrived,) = bench.arrived()
        return arrived

    assert all(scan(number).measurement is not None for number in range(30))
    refused = scan(30, -0.35)
    assert refused.measurement is None
    assert refused.refused == "clock_step"
    assert refused.reason.startswith("clock_step: its stamps have moved by -0.350 s against their arrival")
    assert refused.clock_moved_s == pytest.approx(-0.35, abs=1e-3)
    bench.inputs.health.books["lidar"].lose(Loss(refused.refused, refused.reason), start_s + 3.0)
    level, message, _ = told(bench, start_s + 3.0)
    assert (level, "`reset` the estimator to accept the clock as it is" in message) == (Health.ERROR, True)
    assert scan(31).measurement is not None
    assert scan(32, -0.35).measurement is None
    bench.inputs.request_reset(ResetRequest())
    assert [scan(number, -0.35).measurement is not None for number in range(36, 60)][-20:] == [True] * 20


def test_the_first_frame_that_is_used_after_a_clock_has_moved_says_by_how_much():
    bench, start_s = lidar_bench(), monotonic()
    arrived = []
    for number in range(45):
        moved_s = -0.05 if number >= 30 else 0.0
        due_ns = NOW_NS + number * SECOND_NS // 10
        fields = {name: values + np.float32(1e-3 * number) for name, values in CLOUD.items()}
        when = {"arrival_ns": due_ns + 10_000_000, "arrival_s": start_s + 0.1 * number}
        bench.send_scan(due_ns + round(moved_s * SECOND_NS), fields, **when)
        arrived += bench.arrived()
    moved = [(number, each.measurement is None) for number, each in enumerate(arrived) if each.clock_moved_s]
    assert moved == [*((number, True) for number in range(30, 39)), (39, False)]
    assert [arrived[number].clock_moved_s for number, _ in moved] == pytest.approx([-0.05] * 10, abs=1e-3)


def test_stamps_of_a_second_publisher_say_nothing_of_the_holders_clock(stage):
    for number in range(60):
        stage.number += 99  # 0.1 s
        stage.wait(0.1)
        assert stage.frame(EMULATOR) == 0.0, number
        stage.mount(DRIVER)
        assert stage.frame(DRIVER) is None
