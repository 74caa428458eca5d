import re
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from rpod_runtime.errors import ExtrinsicsError
from rpod_runtime.sensor_data.extrinsics import Extrinsics
from rpod_schemas import messages
from rpod_schemas.bounds import BOUNDS, MODULATION_FREQUENCY_HZ, SCAN_DIRECTIONS, Bound
from rpod_schemas.control import ResetRequest, StartRequest
from rpod_schemas.errors import MessageRejectedError, Reason
from rpod_schemas.poses import make_pose
from rpod_schemas.rmw.cdr import decode, encode
from rpod_schemas.topics import CHASER
from rpod_schemas.types import Camera, EstimatorStatus, LidarInfo, Mode, Odometry, PmdInfo

ICD = Path(__file__).parents[3] / "schemas" / "ICD.md"
PMD = PmdInfo(
    modulation_frequency_hz=np.array([20e6]),
    integration_time_s=1e-3,
    electrons_per_count=9.0,
    saturation_count=4e3,
)
LIDAR = LidarInfo(azimuth_rad=np.zeros(1), elevation_rad=np.zeros(1), scan_time_s=0.5, sigma_range_m=0.01)
CAMERA = Camera(width=352, height=287, fx=682.75, fy=691.42, cx=175.5, cy=143.0)
POSE = Odometry(
    stamp_ns=1,
    frame_id="chaser",
    child_frame_id="target",
    pose=make_pose(),
    linear_m_s=np.zeros(3),
    angular_rad_s=np.zeros(3),
)


def through_the_wire(message):
    return decode(memoryview(bytes(encode(message))), message.__msgtype__)


def pmd_info(**changes):
    message = messages.write_pmd_info(1, "pmd", PMD)
    for name, value in changes.items():
        setattr(message, name, value)
    return messages.read_pmd_info(through_the_wire(message))


def lidar_info(**changes):
    message = messages.write_lidar_info(1, "lidar", LIDAR)
    for name, value in changes.items():
        setattr(message, name, value)
    return messages.read_lidar_info(through_the_wire(message))


def camera(**changes):
    message = messages.write_camera(1, "pmd", CAMERA)
    for name, value in changes.items():
        setattr(message, name, value)
    return messages.read_camera(through_the_wire(message))


def odometry(change):
    message = messages.write_odometry(POSE)
    change(message)
    return messages.read_odometry(through_the_wire(message))


def matrix(**places):
    k = CAMERA.K.ravel().copy()
    for name, value in places.items():
        k[{"fx": 0, "cx": 2, "fy": 4, "cy": 5}[name]] = value
    return camera(k=k)


def placed(**changes):
    def change(message):
        for name, value in changes.items():
            setattr(message.pose.pose.position, name, value)

    return odometry(change)


def moving(part, value):
    return odometry(lambda message: setattr(getattr(message.twist.twist, part), "y", value))


def uncertain(variance):
    covariance = np.zeros((6, 6))
    covariance[2, 2] = variance
    return odometry(lambda message: setattr(message.pose, "covariance", covariance.ravel()))


def sun(value):
    return messages.read_vector_stamped(
        through_the_wire(messages.write_vector_stamped(1, CHASER, np.array([0.0, value, 0.0])))
    )


def cloud(time_s):
    fields = {name: np.ones(3, np.float32) for name in ("x", "y", "z")} | {
        "t": np.full(3, time_s, np.float32)
    }
    return messages.read_points(through_the_wire(messages.write_points(1, "lidar", fields)))


def status(**changes):
    sent = EstimatorStatus(stamp_ns=1, frame_id=CHASER, mode=Mode.LOST)
    message = messages.write_status(sent)
    for name, value in changes.items():
        setattr(message, name, value)
    return messages.read_status(through_the_wire(message))


def depth(value):
    image = np.array([[2.0, value]], np.float32)
    return messages.read_depth(through_the_wire(messages.write_image(1, "c", image, "32FC1")))


def amplitude(value):
    image = np.array([[2.0, value]], np.float32)
    return messages.read_amplitude(through_the_wire(messages.write_image(1, "c", image, "32FC1")))


SAID = {
    "CameraInfo: fx, fy": ("fy", lambda value: matrix(fy=value)),
    "CameraInfo: cx, cy": ("cx", lambda value: matrix(cx=value)),
    "CameraInfo: each of D": ("distortion", lambda value: camera(d=np.array([0.0, value]))),
    "PmdInfo: modulation_frequency_hz": (
        "modulation_frequency_hz",
        lambda value: pmd_info(modulation_frequency_hz=np.array([20e6, value])),
    ),
    "PmdInfo: integration_time_s": ("integration_time_s", lambda value: pmd_info(integration_time_s=value)),
    "PmdInfo: electrons_per_count": (
        "electrons_per_count",
        lambda value: pmd_info(electrons_per_count=value),
    ),
    "PmdInfo: saturation_count": ("saturation_count", lambda value: pmd_info(saturation_count=value)),
    "LidarInfo: azimuth_rad": ("azimuth_rad", lambda value: lidar_info(azimuth_rad=np.array([value]))),
    "LidarInfo: elevation_rad": ("elevation_rad", lambda value: lidar_info(elevation_rad=np.array([value]))),
    "LidarInfo: scan_time_s": ("scan_time_s", lambda value: lidar_info(scan_time_s=value)),
    "LidarInfo: sigma_range_m": ("sigma_range_m", lambda value: lidar_info(sigma_range_m=value)),
    "poses and transforms: x, y, z": ("position", lambda value: placed(z=value)),
    "Odometry: linear velocity, each axis": ("linear velocity", lambda value: moving("linear", value)),
    "Odometry: angular velocity, each axis": ("angular velocity", lambda value: moving("angular", value)),
    "Odometry: variances, in their SI units": ("pose covariance", uncertain),
    "environment/sun: irradiance": ("irradiance", sun),
}
"""By the name in ``BOUNDS``: the field that an error names, and a message that says a value of it."""


def beyond(bound: Bound):
    spans = [st.just(np.inf), st.just(-np.inf), st.just(np.nan)]
    spans += [
        st.floats(bound.high * 1.01, 1e300),
        st.floats(-1e300, bound.low - 1e-3 * abs(bound.low) - 1e-9),
    ]
    return st.one_of(*spans)


@pytest.mark.parametrize("name", SAID)
@given(data=st.data())
def test_a_value_within_its_limits_is_read(name, data):
    SAID[name][1](data.draw(st.floats(BOUNDS[name].low, BOUNDS[name].high)))


@pytest.mark.parametrize("name", SAID)
@given(data=st.data())
def test_a_value_beyond_its_limits_is_rejected_by_name_value_limits_and_remedy(name, data):
    field, say = SAID[name]
    value = data.draw(beyond(BOUNDS[name]))
    if name == "environment/sun: irradiance":
        value = abs(value)  # the length of a vector has no sign
        if value <= BOUNDS[name].high:
            return
    with pytest.raises(MessageRejectedError) as rejected:
        say(value)
    assert rejected.value.reason is (Reason.MALFORMED if np.isfinite(value) else Reason.NOT_FINITE)
    assert field in rejected.value.text or not np.isfinite(value)
    if np.isfinite(value):
        assert str(BOUNDS[name]) in rejected.value.text
        assert BOUNDS[name].remedy in rejected.value.text


@pytest.mark.parametrize("hertz", [5e-324, 1e-300, 1e-3, 1.0, 1e30])
def test_a_frequency_that_no_camera_has_is_rejected(hertz):
    with pytest.raises(MessageRejectedError, match=re.escape(str(MODULATION_FREQUENCY_HZ))):
        pmd_info(modulation_frequency_hz=np.array([hertz]))


def test_a_camera_has_no_nine_frequencies():
    with pytest.raises(MessageRejectedError, match="number is 9, needs 0 to 8"):
        pmd_info(modulation_frequency_hz=np.full(9, 20e6))


def test_more_directions_than_a_scan_can_have_are_rejected_before_anything_is_made_of_them():
    many = np.linspace(-1.0, 1.0, 50_000)
    with pytest.raises(MessageRejectedError, match=re.escape(str(SCAN_DIRECTIONS))) as rejected:
        lidar_info(azimuth_rad=many, elevation_rad=many)
    assert "2,500,000,000" in rejected.value.text
    with pytest.raises(MessageRejectedError, match="100,000, needs 0 to 65,536"):
        lidar_info(azimuth_rad=np.linspace(-1.0, 1.0, 100_000))


@pytest.mark.parametrize("angles", [np.zeros(41), np.arange(41) * 5e-324])
def test_directions_that_are_all_the_same_are_rejected(angles):
    with pytest.raises(
        MessageRejectedError, match=r"the least step between two directions is .* each direction once"
    ):
        lidar_info(azimuth_rad=angles)


def test_directions_may_come_in_falling_order():
    angles = np.linspace(0.3, -0.3, 41)
    np.testing.assert_array_equal(lidar_info(azimuth_rad=angles, elevation_rad=angles).azimuth_rad, angles)


@given(st.integers(1, 2**32 - 1), st.integers(1, 2**32 - 1))
def test_an_image_is_no_larger_than_one_can_be(width, height):
    fits = width <= 8_192 and height <= 8_192 and width * height <= 2**24
    with nullcontext() if fits else pytest.raises(MessageRejectedError, match="needs"):
        camera(width=width, height=height)


@given(st.floats(width=32))
def test_the_pixels_of_images_are_physical_or_unknown(value):
    known = not np.isfinite(value) or abs(value) <= np.float32(
        BOUNDS["depth image: each pixel, where finite"].high
    )
    with nullcontext() if known else pytest.raises(MessageRejectedError, match="depth image"):
        depth(value)
    known = np.isnan(value) or abs(value) <= 2.0**32
    with nullcontext() if known else pytest.raises(MessageRejectedError, match="amplitude image"):
        amplitude(value)


@given(st.floats(width=32))
def test_the_times_of_returns_are_within_a_scan_or_unknown(time_s):
    known = np.isnan(time_s) or abs(time_s) <= 600.0
    with nullcontext() if known else pytest.raises(MessageRejectedError, match="t is"):
        cloud(time_s)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda c: c.__setitem__((0, 1), 2.0), "correlation"),
        (lambda c: c.__setitem__((0, 1), 0.5), "symmetric"),
        (lambda c: c.__setitem__((3, 3), -1.0), "is -1"),
    ],
)
def test_what_is_no_covariance_is_rejected(change, text):
    covariance = np.eye(6)
    change(covariance)
    with pytest.raises(MessageRejectedError, match=text):
        odometry(lambda message: setattr(message.twist, "covariance", covariance.ravel()))
    with pytest.raises(ValidationError, match=text):
        ResetRequest(covariance=covariance)


@given(st.lists(st.floats(-1.0, 1.0), min_size=36, max_size=36), st.floats(1e-9, 1e9))
def test_every_covariance_is_read(numbers, scale):
    root = np.array(numbers).reshape(6, 6)
    covariance = scale * root @ root.T
    odometry(lambda message: setattr(message.pose, "covariance", covariance.ravel()))


@pytest.mark.parametrize(
    "changes",
    [
        {"cost_m2": -1.0},
        {"nis": -1e-3},
        {"processing_s": -5.0},
        {"inlier_share": 1.5},
        {"reason": "x" * 100_000},
        {"hypotheses": [messages.write_pose(make_pose())] * 2, "hypothesis_weights": np.ones(2)},
    ],
)
def test_a_status_that_cannot_be_is_rejected(changes):
    with pytest.raises(MessageRejectedError, match=next(iter(changes)).split("es")[0]):
        status(**changes)


def test_a_sensor_beyond_any_spacecraft_has_no_mount():
    extrinsics = Extrinsics({})
    extrinsics.set(CHASER, "pmd_optical", make_pose(translation_m=[0.0, 0.0, 1e6]))
    with pytest.raises(ExtrinsicsError, match=r"1,000,000, needs 0 to 200 m.*tf_static"):
        extrinsics.mount("pmd", "pmd_optical")


@pytest.mark.parametrize(
    "request_of",
    [
        lambda: ResetRequest(pose=make_pose(translation_m=[1e300, 0.0, 0.0])),
        lambda: ResetRequest(stamp_ns=10**30),
        lambda: ResetRequest(stamp_ns=-1),
        lambda: StartRequest(epoch_ns=10**30),
        lambda: StartRequest(epoch_ns=10**400),
    ],
)
def test_a_request_is_held_to_the_same_limits(request_of):
    with pytest.raises(ValidationError, match=r"needs|Input"):
        request_of()


def test_the_icd_names_every_limit():
    text = ICD.read_text("utf-8")
    for name, bound in BOUNDS.items():
        assert f"| {name} | {bound} | {bound.reason} |" in text
    table = text.split("| field | limits | why |")[1].split("\n\n")[0]
    assert table.count("\n|") - 1 == len(BOUNDS)


@pytest.mark.parametrize(("hertz", "farthest_m"), [((), np.inf), ((20e6,), 7.495), ((80e6, 20e6), 74.95)])
def test_a_camera_measures_as_far_as_its_frequencies_let_it(
    hertz: tuple[float, ...], farthest_m: float
) -> None:
    info = pmd_info(modulation_frequency_hz=np.array(hertz))
    assert info.farthest_m == pytest.approx(farthest_m, rel=1e-3)
