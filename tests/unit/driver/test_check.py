"""The check against the catalogue: each fault is named, and nothing on good sensors."""

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from checked_estimates import estimates_of
from checked_sensors import (
    EPOCH_NS,
    INFO,
    PATTERN,
    SECOND_NS,
    Desk,
    facility,
    facility_frames,
    facility_seen,
    failed,
    ideal_camera,
    room_scanner,
    room_scans,
    wall_camera,
    wall_frames,
    watched,
)
from pydantic import ValidationError
from scipy.spatial.transform import Rotation

from rpod.driver.check import show
from rpod_driver.check import CheckResult, Level, Observer, Options, judge
from rpod_driver.check.content import partial
from rpod_driver.check.geometry import Fitted, checked_mount, fitted
from rpod_driver.check.observations import Kept, Observations, middle_m
from rpod_driver.check.setup import instant
from rpod_driver.check.sightings import sightings_of
from rpod_driver.host import error_line
from rpod_runtime.sensors import CameraPublisher
from rpod_schemas.errors import Reason
from rpod_schemas.faults import BY_NAME, FAULTS, known_fault
from rpod_schemas.poses import make_pose
from rpod_schemas.topics import TF_STATIC
from rpod_schemas.types import Camera, Diagnostic, Health, LidarInfo, LidarScan, PmdFrame

SEEDS = range(int(os.environ.get("RPOD_FAULT_SEEDS", "1")))
"""Seeds of each fault; ten with RPOD_FAULT_SEEDS=10, as in docs/results/drivers.md."""
BESIDE_TRUTH = ("stamp_start", "biased", "mirrored", "mount_off")
"""Faults of a camera that show only beside truth."""
OF_CAMERA = [fault.name for fault in FAULTS if "pmd" in fault.kinds and fault.name not in BESIDE_TRUTH]
OF_SCANNER = [fault.name for fault in FAULTS if "lidar" in fault.kinds and fault.needs != "truth"]


def test_without_any_frame_the_cause_comes_first_and_the_rest_in_one_line(capsys):
    results = judge(Observer("pmd", "pmd", Options()).end(EPOCH_NS))
    show(results)
    lines = [line for line in capsys.readouterr().out.splitlines() if line.strip()]
    assert lines[1].startswith("publisher  fail")
    assert "no depth of 'pmd' came" in lines[1]
    unchecked = sum(each.level is Level.UNCHECKED for each in results)
    assert unchecked > 10
    assert lines[-1].split() == [
        "others",
        "not",
        "checked",
        str(unchecked),
        "further",
        "checks",
        "need",
        "frames",
    ]


def at(results: list[CheckResult], line: str) -> CheckResult:
    (result,) = (each for each in results if each.line == line)
    return result


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("fault", OF_CAMERA)
def test_a_camera_with_a_fault_is_named_by_its_line_with_the_remedy(fault, seed):
    results = wall_camera(fault, seed=seed)
    assert fault in failed(results)
    named = at(results, BY_NAME[fault].line)
    assert named.level is Level.FAIL
    assert BY_NAME[fault].remedy in named.remedy


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("fault", [*OF_SCANNER, "stamp_start", "mirrored"])
def test_a_scanner_with_a_fault_is_named_by_its_line(fault, seed):
    results = room_scanner(fault, seed=seed)
    assert fault in failed(results)
    assert fault in at(results, BY_NAME[fault].line).faults


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("fault", BESIDE_TRUTH)
def test_beside_truth_the_instant_the_range_the_mirror_and_the_mount_are_named(fault, seed):
    assert fault in at(ideal_camera(fault, seed=seed), BY_NAME[fault].line).faults


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("fault", ["biased", "mount_off"])
def test_a_scanner_beside_truth_is_compared_with_it(fault, seed):
    assert fault in at(facility("lidar", fault, seed=seed), BY_NAME[fault].line).faults


@pytest.mark.parametrize("seed", SEEDS)
def test_beside_a_second_sensor_of_1_hz_a_mount_that_is_off_is_named(seed):
    estimates = estimates_of("lidar", rate_hz=1.0, seed=seed)
    named = at(ideal_camera("mount_off", seed=seed, estimates=estimates), "mount_second")
    assert (named.level, named.faults) == (Level.FAIL, ("mount_off",)), named.text
    assert "lidar" in named.text
    good = at(ideal_camera(seed=seed, estimates=estimates), "mount_second")
    hidden = {Level.UNCHECKED} if seed else set()  # of ten seeds one shows too little, and says so
    assert good.level in {Level.OK} | hidden, good.text


def test_the_mount_of_the_second_sensor_counts_as_well():
    turned = make_pose(rotation=Rotation.from_euler("y", 5.0, degrees=True))
    estimates = estimates_of("lidar", rate_hz=10.0, seed=0, off=turned)
    named = at(ideal_camera(estimates=estimates), "mount_second")
    assert named.faults == ("mount_off",)
    assert named.figures["turned_deg"] == pytest.approx(5.0, abs=0.5)


def test_a_mount_that_the_points_fit_no_better_than_the_published_one_is_not_called_off():
    """The ranges of a camera wiggle, which tilts a target that is seen from one side only."""
    values = np.array([0.0, 0.0, 0.02, 0.0, 0.0, 0.1, 0.0, 0.0])
    tilted = Fitted(values, np.diag(np.full(8, 0.01) ** 2), residual_m=0.01, improvement=1.0)
    assert checked_mount(tilted).level is Level.UNCHECKED
    assert checked_mount(replace(tilted, improvement=0.4)).faults == ("mount_off",)


def test_an_estimate_that_uses_the_sensor_itself_does_not_judge_its_mount():
    estimates = [*estimates_of("lidar", rate_hz=5.0, seed=0), *estimates_of("front", rate_hz=1.0, seed=1)]
    result = at(ideal_camera("mount_off", estimates=estimates), "mount_second")
    assert result.level is Level.UNCHECKED
    assert "uses 'front' itself" in result.text


def test_every_fault_of_a_sensors_messages_is_seen_by_one_of_these_tests():
    assert {*OF_CAMERA, *OF_SCANNER, *BESIDE_TRUTH} == {fault.name for fault in FAULTS}


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(
    "sensor", [wall_camera, room_scanner, ideal_camera, lambda seed: facility("pmd", seed=seed),
               lambda seed: facility("lidar", seed=seed)],
    ids=["camera", "scanner", "ideal camera", "facility's camera", "facility's scanner"],
)  # fmt: skip
def test_nothing_is_wrong_with_a_good_sensor(sensor, seed):
    results = sensor(seed=seed)
    assert [(each.line, each.text) for each in results if each.level is Level.FAIL] == []
    assert sum(each.level is Level.OK for each in results) >= 16


def test_what_cannot_be_seen_is_not_called_in_order():
    results = wall_camera()
    for line in ("instant", "grid", "range", "mount_truth", "mount_second"):
        assert at(results, line).level is Level.UNCHECKED
        assert "--target" in at(results, line).text
    blind = judge(watched("pmd", wall_frames(0, 1.0), INFO, latency_s=0.01))
    assert "--rate" in at(blind, "rate").text
    assert at(blind, "drift").level is Level.UNCHECKED


def test_a_camera_that_sees_no_plane_is_not_told_to_have_z_depth():
    random = np.random.default_rng(3)

    def clouds():
        for frame in wall_frames(0, 4.0):
            depth_m = random.uniform(1.0, 4.0, frame.depth_m.shape).astype(np.float32)
            yield frame.model_copy(update={"depth_m": depth_m})

    result = at(judge(watched("pmd", clouds(), INFO, latency_s=0.01)), "depth_model")
    assert result.level is Level.UNCHECKED
    assert "show it a wall" in result.text


def test_the_motion_tells_the_instant_of_a_stamp_to_a_millisecond():
    good, early = (at(ideal_camera(*faults), "instant").figures for faults in ((), ("stamp_start",)))
    assert abs(good["offset_s"]) < 1e-3
    assert early["offset_s"] == pytest.approx(8e-3, abs=1e-3)


@pytest.mark.parametrize(
    ("late_s", "level", "words"),
    [
        (0.0, Level.OK, "after their last point"),
        (0.03, Level.FAIL, "at least 0.0"),
        (0.25, Level.FAIL, "ahead of this machine's clock"),
        (-0.3, Level.NOTE, "may be up to 0.3"),
    ],
)
def test_a_scanner_alone_tells_an_offset_of_its_clock_as_far_as_arrivals_show_it(late_s, level, words):
    scans = ((scan, scan.stamp_ns + round(late_s * SECOND_NS)) for scan in room_scans(0, 8.0))
    frames = (scan.model_copy(update={"stamp_ns": stamp_ns}) for scan, stamp_ns in scans)
    # The desk hands a frame over at its stamp and the latency: what is late arrives as much earlier.
    seen = watched("lidar", frames, PATTERN, latency_s=0.04 - late_s, options=Options(rate_hz=10.0))
    result = at(judge(seen), "clock")
    assert result.level is level, result.text
    assert words in result.text
    assert ("clock_ahead" in result.faults) == (level is Level.FAIL)


@pytest.mark.parametrize(("late_s", "fault"), [(0.1, "clock_ahead"), (-0.3, "clock_behind")])
def test_beside_truth_an_offset_of_a_scanners_clock_is_named(late_s, fault):
    result = at(facility("lidar", late_s=late_s), "instant")
    assert result.faults == (fault,), result.text
    assert result.figures["offset_s"] == pytest.approx(-late_s, abs=0.02)


def test_times_of_points_count_where_stamps_are_not_in_the_middle_of_a_scan():
    """Points that are stamped later and have times as much earlier were measured at the same instants."""
    for timed, expected_s in ((True, 0.0), (False, -0.06)):
        seen = facility_seen("lidar", late_s=0.06, timed=timed)
        surface = seen.options.surface
        _, sightings, mount = sightings_of(seen, surface, seen.truth, gap_s=0.05)
        assert fitted(sightings, surface, mount).values[0] == pytest.approx(expected_s, abs=0.015)


def test_beside_a_second_sensor_an_offset_of_the_clocks_is_named():
    estimates = estimates_of("lidar", rate_hz=5.0, seed=0)
    result = at(ideal_camera(estimates=estimates, late_s=0.08), "mount_second")
    assert result.faults == ("clock_ahead",), result.text
    assert "these stamps, or those of lidar" in result.text


def test_values_that_no_calibration_can_have_are_not_judged():
    late_s = np.array([1.2, 0.0, 0.3, 0.0, 0.0, 0.1, 0.0, 0.0])  # of a loaded machine, 9 s of a steady turn
    assert Fitted(late_s, np.eye(8), 0.01, 1.0).is_implausible
    assert not Fitted(
        np.array([0.01, 0.1, 0.08, 0.0, 0.0, 0.05, 0.0, 0.0]), np.eye(8), 0.01, 1.0
    ).is_implausible


def test_a_sensor_that_is_not_there_gives_one_failure_and_no_line_in_order():
    results = judge(watched("pmd", (), None, latency_s=0.0, options=Options(rate_hz=10.0)))
    assert [each.line for each in results if each.level is Level.FAIL] == ["publisher"]
    assert not [each.line for each in results if each.level is Level.OK]
    assert "no sensor is on this bus" in at(results, "publisher").text


def test_where_no_frame_comes_the_publishers_that_are_there_are_named():
    observer = Observer("pmd", "front")
    names = "rosout", "frnt/depth/image_raw", "frnt/camera_info"
    observer.take_tokens([(name, "::,", "other") for name in names])
    text = at(judge(observer.end(EPOCH_NS)), "publisher").text
    assert "nobody publishes front/depth/image_raw" in text
    assert "published are frnt/camera_info, frnt/depth/image_raw:" in text
    observer.take_tokens([("front/depth/image_raw", "::,", "own")])
    assert "has a publisher, which sends nothing" in at(judge(observer.end(EPOCH_NS)), "publisher").text


def test_where_a_publisher_sends_nothing_the_failing_driver_is_quoted():
    observer = Observer("pmd", "front")
    observer.take_tokens([("front/depth/image_raw", "::,", "own")])
    failing = Diagnostic(
        stamp_ns=1, name="driver", level=Health.ERROR, message="depth_m: is of float64", values={}
    )
    observer.seen.diagnostics = {"driver": failing}
    assert "; driver says: depth_m: is of float64" in at(judge(observer.end(EPOCH_NS)), "publisher").text


def test_a_frame_with_wrong_values_is_told_in_one_line_with_what_it_needs():
    with pytest.raises(ValidationError) as caught:
        PmdFrame(
            stamp_ns=1, frame_id="", depth_m=np.ones((4, 6)), amplitude=np.ones(4),
            camera=Camera(width=6, height=4, fx=5.0, fy=5.0, cx=2.5, cy=1.5),
        )  # fmt: skip
    assert error_line(caught.value) == (
        "PmdFrame: depth_m: is of float64, needs an array of float32: np.asarray(..., np.float32); "
        "amplitude: has shape (4,), needs an array of shape (height, width)"
    )
    assert error_line(OSError("no device")) == "no device"
    assert error_line(OSError()) == "OSError"


def test_a_result_becomes_json():
    results = [each.model_dump(mode="json") for each in wall_camera(duration_s=3.0)]
    assert json.loads(json.dumps(results, allow_nan=False)) == results


def test_pixels_of_16_bits_without_a_depth_are_no_distances():
    raw = np.full((4, 4), 2000, np.uint16)
    raw[0] = 0
    raw[1:] = 65535
    raw[1, 0] = 2000
    assert middle_m(raw, "16UC1") == 2.0


def test_the_catalogue_names_lines_of_the_check():
    lines = {each.line for each in (*wall_camera(duration_s=1.0), *room_scanner(duration_s=1.0))}
    assert {fault.line for fault in FAULTS} <= lines
    assert known_fault("frozen").name == "frozen"


VOLATILE = replace(TF_STATIC, latched=False)
BOTTLE = Path(__file__).parents[2] / "data" / "depth_bottle"


def test_recorded_frames_of_a_stereo_camera_are_in_order():
    """Two real frames (tests/data/depth_bottle, MIT): what two frames cannot show is not checked."""
    import cv2  # noqa: PLC0415

    camera = Camera(width=848, height=480, fx=425.773, fy=425.773, cx=427.202, cy=237.662)
    images = [cv2.imread(str(BOTTLE / f"depth_{number}.png"), cv2.IMREAD_UNCHANGED) for number in (200, 201)]
    frames = [
        PmdFrame(
            stamp_ns=EPOCH_NS + SECOND_NS + number * 33_333_333,
            frame_id="",
            depth_m=np.where(image > 0, image * np.float32(1e-3), np.float32(np.nan)).astype(np.float32),
            amplitude=None,
            camera=camera,
        )
        for number, image in enumerate(images)
    ]
    for name in ("", "radial_depth", "millimetres"):
        results = judge(watched("pmd", frames, None, latency_s=0.02, faults=(name,) if name else ()))
        if name != "radial_depth":
            assert failed(results) == ({name} if name else set()), results
    assert at(judge(watched("pmd", frames, None, latency_s=0.02)), "jitter").level is Level.UNCHECKED


def test_latched_topics_without_a_token_of_their_publisher_are_not_said_to_be_in_order():
    seen = watched("pmd", wall_frames(1, 3.0), INFO, latency_s=0.02, options=Options(rate_hz=10.0))
    assert at(judge(seen), "qos").level is Level.OK
    del seen.qos["tf_static"]
    told = at(judge(seen), "qos")
    assert told.level is Level.UNCHECKED
    assert "tf_static" in told.text


def test_a_volatile_tf_static_of_another_node_is_no_fault_of_a_sensor_whose_mount_is_known():
    seen = watched("pmd", wall_frames(1, 3.0), INFO, latency_s=0.02, options=Options(rate_hz=10.0))
    (offer,) = seen.qos["tf_static"]
    volatile = offer._replace(qos=VOLATILE.offered.token(), session="another")
    seen.qos["tf_static"].add(volatile)
    assert at(judge(seen), "qos").level is Level.OK
    seen.mounts.clear()  # now it may be the reason
    assert at(judge(seen), "qos").faults == ("not_latched",)


# --- a loaded machine ---


def frames_at(numbers, *, late_s=lambda _: 0.0, rate_hz=5.0, kind="pmd"):
    """Return what came of a camera whose frames have these numbers, each late by some time, on a grid."""
    frames = list(wall_frames(3, 1.0))
    desk = Desk(kind, "front", options=Options(rate_hz=rate_hz))
    publisher = CameraPublisher(desk, "front", T_chaser_sensor=make_pose(), info=INFO)
    for place, number in enumerate(numbers):
        stamp_ns = EPOCH_NS + SECOND_NS + round(number * SECOND_NS / rate_hz)
        desk.deliver(max(desk.now, stamp_ns + round((0.02 + late_s(number)) * SECOND_NS)))
        publisher.publish(frames[place % len(frames)].model_copy(update={"stamp_ns": stamp_ns}))
    return desk.end()


def test_stamps_are_even_although_most_frames_are_missing():
    numbers = np.cumsum(np.random.default_rng(1).choice([2, 3, 3, 4], 40))
    result = at(judge(frames_at(numbers)), "jitter")
    assert result.level is Level.OK, result.text


def test_a_machine_that_delays_most_frames_is_no_clock_that_is_behind():
    result = at(judge(frames_at(range(60), late_s=lambda number: 0.1 if number % 5 == 0 else 1.2)), "clock")
    assert result.faults == ("slow_rate",), result.text
    assert "they wait before they are sent" in result.text


def test_a_driver_that_falls_behind_its_stamps_has_no_drifting_clock():
    results = judge(frames_at(range(60), late_s=lambda number: 1.2 + 0.8 * number / 5.0))
    assert at(results, "drift").level is Level.UNCHECKED, at(results, "drift").text
    assert at(results, "clock").faults == ("slow_rate",), at(results, "clock").text


def test_a_load_that_comes_is_no_drift_of_the_clock():
    result = at(judge(frames_at(range(100), late_s=lambda number: 0.25 if number > 60 else 0.0)), "drift")
    assert result.level is not Level.FAIL, result.text


def test_surfaces_that_are_no_plane_tell_no_depth_model(monkeypatch):
    """A good camera measured these values live before a tumbling target, whose surface is no plane."""
    curved = iter([-11.8, -20.1, 1.47, 0.65] * 3)

    def flatness(_):
        return (
            np.sqrt(1e-4 - 2e-5 * (ratio := next(curved)) * (ratio < 0)),
            np.sqrt(1e-4 + 2e-5 * ratio * (ratio > 0)),
            2e-5**0.5,
        )

    monkeypatch.setattr("rpod_driver.check.plane._flatness", flatness)
    seen = watched("pmd", wall_frames(1, 1.5), INFO, latency_s=0.01)
    result = at(judge(seen), "depth_model")
    assert result.level is not Level.FAIL, result.text


def test_rows_that_never_have_a_return_between_others_are_noted_with_the_remedy():
    _, frames = facility_frames("lidar")
    dead = []
    for frame in frames:
        points_m = frame.points_m.copy()
        points_m[1::4] = np.nan
        dead.append(frame.model_copy(update={"points_m": points_m}))
    sensor, _ = facility_frames("lidar")
    seen = [watched("lidar", each, sensor.info(), latency_s=sensor.latency_s) for each in (frames, dead)]
    whole, holed = (at(judge(each), "returns") for each in seen)
    assert whole.level is Level.OK
    assert holed.level is Level.NOTE
    assert "gaps in or beside the target, or dead channels" in holed.text
    assert "write dead_rows: [" in holed.text


def test_stamps_that_are_seconds_off_are_not_compared_with_truth():
    results = facility("lidar", late_s=-3.0)
    assert at(results, "clock").faults == ("clock_behind",)
    for line in ("range", "mount_truth"):
        assert "correct the clock first" in at(results, line).text


def kept_observations(kind, frames):
    """Return observations of frames of which the ones between were not kept."""
    seen = Observations(kind, kind, Options())
    seen.kept = [Kept(number, frame, frame.range_image_m, "32FC1") for number, frame in frames]
    return seen


def test_frames_of_which_no_two_are_successive_are_not_checked_for_cuts():
    camera = Camera(width=4, height=4, fx=4.0, fy=4.0, cx=1.5, cy=1.5)
    frame = PmdFrame(
        stamp_ns=1, frame_id="", depth_m=np.ones((4, 4), np.float32), amplitude=None, camera=camera
    )
    result = partial(kept_observations("pmd", [(number, frame) for number in (0, 8, 14, 22)]))
    assert (result.level, result.text) == (Level.UNCHECKED, "no two successive frames could be read")


def test_a_scan_without_times_does_not_hide_the_instant_of_the_others():
    azimuth, elevation = np.linspace(-0.3, 0.3, 10), np.linspace(-0.2, 0.2, 8)
    info = LidarInfo(azimuth_rad=azimuth, elevation_rad=elevation, scan_time_s=0.1, sigma_range_m=0.0)
    points_m = np.ones((8, 10, 3), np.float32)
    late = np.linspace(0.0, 0.1, 80, dtype=np.float32).reshape(8, 10)
    scans = [
        LidarScan(stamp_ns=number, frame_id="", points_m=points_m, time_s=time_s)
        for number, time_s in enumerate((late, late, np.full((8, 10), np.nan, np.float32)))
    ]
    seen = kept_observations("lidar", enumerate(scans))
    seen.infos = [(None, info)]
    result = instant(seen)
    assert (result.level, result.figures["middle_share"]) == (Level.FAIL, pytest.approx(0.5))


def test_a_message_beside_the_sensors_own_that_cannot_be_read_is_no_fault_of_its_frames():
    seen = watched("pmd", wall_frames(0, 1.0), INFO, latency_s=0.01)
    before = at(judge(seen), "content")
    seen.refused_beside.append((Reason.MALFORMED, "truth/odometry: 3 bytes"))
    told = at(judge(seen), "content")
    assert (before.level, told.level) == (Level.OK, Level.NOTE)
    assert told.text == f"{before.text}; 1 messages beside them cannot be read: truth/odometry: 3 bytes"
