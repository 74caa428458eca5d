"""Valid messages and logs, from which hostile ones are made."""

from functools import cache
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from malformed_logs import INFO, write_good
from mcap.reader import make_reader
from scipy.spatial.transform import Rotation
from synthetic_log import SyntheticRun

from rpod_schemas.messages import (
    write_command,
    write_imu,
    write_integrity,
    write_joints,
    write_lidar_info,
    write_validity,
)
from rpod_schemas.rmw.cdr import encode
from rpod_schemas.topics import (
    AMPLITUDE,
    CAMERA_INFO,
    CHASER,
    COMMAND,
    DEPTH,
    DIAGNOSTICS,
    ESTIMATE,
    ESTIMATE_POSE,
    IMU,
    INTEGRITY,
    LIDAR_INFO,
    PMD_INFO,
    POINTS,
    REFERENCE,
    STATUS,
    SUN,
    TF,
    TF_STATIC,
    TRUTH,
    TRUTH_JOINTS,
    VALIDITY,
    Topic,
)
from rpod_schemas.types import (
    Command,
    EstimateValidity,
    ImuReading,
    Integrity,
    IntegrityState,
    Joints,
    LidarInfo,
)

TOPICS = (
    TRUTH_JOINTS, VALIDITY, LIDAR_INFO.of("lidar"), TF, SUN, REFERENCE, TRUTH, TF_STATIC, PMD_INFO.of("pmd"),
    CAMERA_INFO.of("pmd"), DEPTH.of("pmd"), AMPLITUDE.of("pmd"), DIAGNOSTICS, ESTIMATE, ESTIMATE_POSE, STATUS,
    POINTS.of("lidar"), IMU, COMMAND, INTEGRITY,
)  # fmt: skip
"""Topics whose messages are made hostile."""


@cache
def logs() -> tuple[bytes, ...]:
    """Return the bytes of a log with a camera and of one with a LIDAR, half a second each."""
    with TemporaryDirectory() as folder:
        pmd = SyntheticRun(
            duration_s=0.5, rate_hz=10.0, truth_rate_hz=50.0, clock=True, info=INFO, target="mockup"
        )
        lidar = SyntheticRun(duration_s=0.5, rate_hz=10.0, truth_rate_hz=50.0, kind="lidar", name="lidar")
        paths = write_good(Path(folder) / "pmd.mcap", pmd), lidar.write(Path(folder) / "lidar.mcap")
        return tuple(path.read_bytes() for path in paths)


@cache
def messages() -> dict[Topic, bytes]:
    """Return a valid message of each topic of ``TOPICS``."""
    found = {
        TRUTH_JOINTS: write_joints(Joints(stamp_ns=1, angle_rad={"arm": 0.1}, rate_rad_s={"arm": 0.0})),
        VALIDITY: write_validity(
            EstimateValidity(stamp_ns=1, frame_id="chaser", valid=True, age_s=0.1, reason="")
        ),
        IMU: write_imu(
            ImuReading(
                stamp_ns=1,
                frame_id=CHASER,
                rate_rad_s=np.zeros(3),
                rate_variance=1e-6,
                force_m_s2=np.ones(3),
                R_orbit_chaser=Rotation.identity(),
            )
        ),
        COMMAND: write_command(
            Command(stamp_ns=1, frame_id=CHASER, acceleration_m_s2=np.ones(3), variance=1e-6)
        ),
        INTEGRITY: write_integrity(
            Integrity(
                stamp_ns=1,
                frame_id=CHASER,
                state=IntegrityState.NOMINAL,
                risk=1e-4,
                attitude_level_deg=1.0,
                position_level_m=0.1,
                evidence={"a": 1.0},
            )
        ),
        LIDAR_INFO.of("lidar"): write_lidar_info(
            1,
            "lidar",
            LidarInfo(
                azimuth_rad=np.array([-0.1, 0.0, 0.1]),
                elevation_rad=np.array([-0.1, 0.1]),
                scan_time_s=0.5,
                sigma_range_m=0.02,
            ),
        ),
    }
    payloads = {topic: bytes(encode(message)) for topic, message in found.items()}
    by_name = {topic.name: topic for topic in TOPICS}
    for log in logs():
        for _, channel, message in make_reader(BytesIO(log)).iter_messages():
            topic = by_name.get(channel.topic.lstrip("/"))
            if topic is not None:
                payloads.setdefault(topic, bytes(message.data))
    return {topic: payloads[topic] for topic in TOPICS}
