"""What the estimator says of mistakes of a first day that a frame does not show by its form."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rpod_estimator.estimator import SLOW_SEARCH, SLOW_SEARCH_S, Estimator
from rpod_estimator.frame_hint import described
from rpod_estimator.frame_reader import Arrived
from rpod_estimator.inputs.book import Loss, SensorBook
from rpod_estimator.inputs.health import InputHealth
from rpod_pose.measurement import Measurement
from rpod_runtime import Received
from rpod_runtime.assembler import Assembled
from rpod_runtime.health import HealthBook
from rpod_runtime.readers.lidar import LidarReader
from rpod_runtime.sensor_data.extrinsics import in_words
from rpod_schemas.config.base import check
from rpod_schemas.config.estimator import EstimatorConfig
from rpod_schemas.errors import ConfigurationError
from rpod_schemas.messages import write_lidar_info, write_points
from rpod_schemas.poses import make_pose
from rpod_schemas.rmw.cdr import encode
from rpod_schemas.rmw.wire import Attachment
from rpod_schemas.topics import POINTS
from rpod_schemas.types import Camera, Health, LidarInfo, LidarScan, PmdFrame
from rpod_target import load_target

SECOND_NS = 1_000_000_000
AZIMUTH_RAD, ELEVATION_RAD = np.radians(np.arange(-14.0, 14.5)), np.radians(np.arange(-9.0, 9.5))
FORWARD = Rotation.from_matrix([[0, 0, 1], [-1, 0, 0], [0, -1, 0]])


def info(azimuth_rad=AZIMUTH_RAD, elevation_rad=ELEVATION_RAD):
    return LidarInfo(
        azimuth_rad=azimuth_rad, elevation_rad=elevation_rad, scan_time_s=0.1, sigma_range_m=0.02
    )


def sphere():
    """Return the points of a sphere of 1 m radius at 5 m, shape (rows, columns, 3), NaN beside it."""
    az, el = np.meshgrid(AZIMUTH_RAD, ELEVATION_RAD)
    ways = np.stack((np.sin(az) * np.cos(el), np.sin(el), np.cos(az) * np.cos(el)), axis=-1)
    along_m = 5.0 * ways[..., 2]
    with np.errstate(invalid="ignore"):
        range_m = along_m - np.sqrt(along_m**2 - 24.0)
    return (ways * range_m[..., None]).astype(np.float32)


def part_of(points_m):
    """Return a received message with the points of a scan."""
    cloud = write_points(1, "lidar", {axis: points_m[..., n].copy() for n, axis in enumerate("xyz")})
    attachment = Attachment(1, 0, bytes(16))
    return Received(POINTS.of("lidar"), "k", memoryview(bytes(encode(cloud))), attachment, 0, 0.0)


def doubt_of(points_m, said, *, again=None):
    """Return what a reader says of a scan of these points beside an info, and a second one if given."""
    reader, part = LidarReader(), part_of(points_m)
    for each in (said, again):
        if each is not None:
            reader.learn(write_lidar_info(1, "lidar", each))
            reader.read(Assembled(1, {"points": part}))
    return reader.inconsistency


@pytest.mark.parametrize("name", ["azimuth", "elevation"])
def test_an_info_whose_angles_run_the_other_way_is_named(name):
    stated = info()
    turned = stated.model_copy(update={f"{name}_rad": -getattr(stated, f"{name}_rad")})
    text = doubt_of(sphere(), turned)
    assert f"{name}_rad of the info runs the other way than the points" in text
    assert "elevations downwards" in text
    assert doubt_of(sphere(), turned, again=stated) == ""


def test_points_that_agree_with_their_info_are_consistent():
    assert doubt_of(sphere(), info()) == ""


def test_azimuths_and_elevations_exchanged_in_the_info_are_told_until_the_info_is_right():
    exchanged = info(ELEVATION_RAD, AZIMUTH_RAD)
    told = doubt_of(sphere(), exchanged)
    assert "scans have 19 x 29 points, elevations by azimuths, the info states 29 x 19" in told
    assert doubt_of(sphere(), exchanged, again=info()) == ""


def test_angles_exchanged_in_the_points_are_told():
    assert "are azimuth and elevation, or the axes of the points, exchanged?" in doubt_of(
        sphere()[..., [1, 0, 2]], info()
    )


def test_points_in_the_robots_frame_lie_beside_the_info_and_are_told():
    mount = make_pose(rotation=Rotation.from_euler("ZYX", [10.0, -5.0, 3.0], degrees=True))
    moved = mount.apply(sphere().reshape(-1, 3).astype(float)).reshape(sphere().shape)
    assert "in the sensor's own axes, or state no pattern" in doubt_of(moved.astype(np.float32), info())


@pytest.mark.parametrize("axis", ["azimuth_rad", "elevation_rad"])
def test_a_pattern_in_degrees_is_refused_with_the_question(axis):
    pattern = {"azimuth_rad": AZIMUTH_RAD.tolist(), "elevation_rad": ELEVATION_RAD.tolist()}
    pattern[axis] = np.degrees(pattern[axis]).tolist()
    document = {"target": "mockup", "sensors": [{"kind": "lidar", **pattern}]}
    with pytest.raises(ConfigurationError, match=rf"{axis}.*are they degrees\?"):
        check(EstimatorConfig, document, source="test")


def scan(points_m):
    return LidarScan(stamp_ns=1, frame_id="l", points_m=points_m.astype(np.float32))


def test_points_ahead_of_x_name_the_field_for_their_axes():
    forward = FORWARD.apply(sphere().reshape(-1, 3)).reshape(sphere().shape)
    told = described(scan(forward), radius_m=1.0, side_m=2.0)
    assert "ahead along its x axis, not along z: set source.axes of the sensor to forward" in told
    assert "axis" not in described(scan(sphere()), radius_m=1.0, side_m=2.0)


@pytest.mark.parametrize(
    ("turned_deg", "place"), [(-90.0, "to the left of its boresight"), (170.0, "behind it")]
)
def test_points_beside_or_behind_a_lidar_say_where_they_are_and_what_to_turn(turned_deg, place):
    """A Hesai whose azimuth of 0 is at the target has its points along y, to the left of its x axis."""
    turn = Rotation.from_euler("y", turned_deg, degrees=True)
    seen = scan(turn.apply(sphere().reshape(-1, 3)).reshape(sphere().shape))
    config = check(EstimatorConfig, {"target": "mockup", "sensors": [{"kind": "lidar"}]}, source="test")
    arrived = Arrived("lidar", seen.stamp_ns, 0.0, Measurement("lidar", seen, make_pose()))
    told = Estimator(config, load_target("mockup")).process(arrived).status.reason
    assert "no scan pattern" in told
    assert place in told
    assert "turn the sensor, or the axes of its driver" in told


def test_a_mount_is_told_in_words_that_show_an_exchange_of_axes():
    told = in_words(make_pose(rotation=FORWARD, translation_m=(0.1, -0.05, 0.2)))
    assert told == (
        "at (0.100, -0.050, 0.200) m of the chaser, looks along +x (0.0 deg off), right of its image is -y "
        "(0.0 deg off)"
    )
    turned = in_words(make_pose(rotation=Rotation.from_euler("y", -20.0, degrees=True)))
    assert "looks along +z (20.0 deg off), right of its image is +x (20.0 deg off)" in turned


class NeverEnding:
    """A port whose searches have no result."""

    def result(self, _search):
        return None

    def keep(self, _searches):
        pass


def test_a_search_that_takes_long_is_told_with_what_is_measured_before_ten_seconds():
    """Depth in another unit makes of the target a body that is searched for a minute."""
    config = check(EstimatorConfig, {"target": "mockup", "sensors": [{"kind": "pmd"}]}, source="test")
    target = load_target("mockup")
    estimator = Estimator(config, target, lambda _methods, _setups: NeverEnding())
    camera = Camera(width=120, height=90, fx=190.0, fy=190.0, cx=59.5, cy=44.5)
    health = InputHealth(HealthBook("estimator"), {"pmd": "depth"}, now_s=0.0)
    book, told_s = health.books["pmd"], None
    rng = np.random.default_rng(1)
    for number in range(100):
        now_s = 0.1 * number
        depth_m = (25.0 + rng.normal(0.0, 0.05, (90, 120))).astype(np.float32)
        frame = PmdFrame(
            stamp_ns=SECOND_NS + round(now_s * SECOND_NS), frame_id="c", depth_m=depth_m, amplitude=None,
            camera=camera,
        )  # fmt: skip
        arrived = Arrived("pmd", frame.stamp_ns, now_s, Measurement("pmd", frame, make_pose()))
        output = estimator.process(arrived)
        book.note_arrival(now_s)
        health.judge(arrived, output, now_s)
        state = book.state(now_s)
        if told_s is None and state.level != Health.OK:
            told_s = now_s
    assert told_s is not None
    assert SLOW_SEARCH_S <= told_s < 10.0
    assert state.level == Health.WARN
    assert SLOW_SEARCH in state.text
    assert "m wide at most: if nothing else is in view, distances are in another unit" in state.text
    assert "source.depth_unit_m" in state.text


def test_rows_without_a_return_between_others_are_named_only_where_scans_are_refused():
    reader, points_m = LidarReader(), sphere()
    points_m[7:12:2] = np.nan
    reader.learn(write_lidar_info(1, "lidar", info()))
    for _ in range(3):
        reader.read(Assembled(1, {"points": part_of(points_m)}))
    assert "write dead_rows: [7, 9, 11] for the sensor" in reader.hint
    assert reader.inconsistency == ""
    book = SensorBook("lidar", "points", now_s=0.0)
    book.note("hint", reader.hint)
    for number in range(1, 40):
        book.note_arrival(0.1 * number)
        book.use(0.1 * number)
    assert book.state(4.0).text == ""
    for number in range(40, 80):
        book.note_arrival(0.1 * number)
        book.lose(Loss("rejected", "37 more are missing"), 0.1 * number)
    assert "37 more are missing; 3 rows had no return in 3 scans" in book.state(8.0).text


def test_columns_of_a_scan_all_around_are_named_as_the_declaration_counts_them_from_the_first_ahead():
    ahead_m = sphere()
    ahead_m[:, 13] = np.nan
    behind = np.full((ahead_m.shape[0], 50, 3), np.nan, np.float32)
    azimuth_rad = np.concatenate((np.radians(np.linspace(-170.0, -100.0, 50)), AZIMUTH_RAD))
    reader = LidarReader()
    reader.learn(write_lidar_info(1, "lidar", info(azimuth_rad)))
    for _ in range(3):
        scan = reader.read(Assembled(1, {"points": part_of(np.concatenate((behind, ahead_m), axis=1))}))
    assert scan.points_m.shape == ahead_m.shape
    assert "write dead_columns: [13] for the sensor" in reader.hint
