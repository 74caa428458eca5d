"""Poses of a sensor and of the truth, from a log.

The sensor's poses are measured again, frame by frame, by the estimator's own method: the logged estimates are
filtered, so that their errors are correlated and a filter's delay would count as the clock's. For a log
without frames, or without an estimator's configuration, the estimates serve, and the result says so.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from rpod_analysis.calibration.hand_eye.poses import StampedPoses
from rpod_analysis.errors import CalibrationError, NoEstimatorError, NoFramesError, NoTruthError
from rpod_analysis.log import Log
from rpod_analysis.log.sensors import Sensor, find_sensors
from rpod_analysis.log.stamp_check import StampCheck
from rpod_analysis.replay.navigate import configured_estimator, estimator_outputs
from rpod_analysis.scoring.run import estimate_prefix
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.estimator import EstimatorConfig
from rpod_schemas.config.sensor import RANGE_OFFSET_SIGMA_M
from rpod_schemas.config.source import SourceConfig
from rpod_schemas.messages import read_odometry
from rpod_schemas.poses import make_pose
from rpod_schemas.topics import CHASER, ESTIMATE, STATUS, TRUTH


@dataclass(frozen=True, eq=False)
class LoggedPoses:
    """Poses of a sensor and of the truth, from one log."""

    measured: StampedPoses
    """Poses T_sensor_target, in axes with z along the boresight."""
    truth: StampedPoses
    """Poses T_chaser_holder."""
    sensor: Sensor
    source: SourceConfig
    """How the sensor is published, with the correction that the driver has already applied to the stamps."""
    depth_sigma_m: float
    """Standard deviation of the offset of the sensor's distances before this log, m."""
    filtered: bool
    """Whether the poses are the log's filtered estimates, not measurements of single frames."""


def poses_of(log: Log, name: str | None, config: EstimatorConfig | None = None) -> LoggedPoses:
    """Return the poses of a sensor and the truth.

    Args:
        log: log with frames of the sensor and the truth.
        name: name of the sensor; None if the log has only one.
        config: configuration of the estimator that measures; by default that in the log.

    Raises:
        CalibrationError: the log lacks the sensor, the truth, or poses.
        TargetError: the target cannot be loaded.
    """
    sensor = _sensor(log, name)
    truth = _truth(log)
    if config is None:
        try:
            config = configured_estimator(log)
        except NoEstimatorError:
            config = None
    inputs = [item for item in config.sensors if item.name == sensor.name] if config else []
    if config is None or not inputs:
        return LoggedPoses(_estimates(log, sensor), truth, sensor, sensor.source, RANGE_OFFSET_SIGMA_M, True)
    measuring = inputs[0]
    if sensor.T_chaser_sensor is None and measuring.T_chaser_sensor is None:
        measuring = measuring.model_copy(update={"T_chaser_sensor": make_pose()})  # any mount will do here
    measured = _measurements(log, config.model_copy(update={"sensors": (measuring,)}))
    return LoggedPoses(measured, truth, sensor, measuring.source, measuring.range_offset_sigma_m, False)


def _sensor(log: Log, name: str | None) -> Sensor:
    sensors = find_sensors(log)
    if name is None and len(sensors) == 1:
        return next(iter(sensors.values()))
    if not sensors:
        raise NoFramesError(log.paths[0].name)
    if name not in sensors:
        known = ", ".join(sorted(sensors))
        asked = "more than one sensor" if name is None else f"no frames of {name!r}"
        raise CalibrationError(f"{log.paths[0].name}: {asked}; it has {known}: choose with --sensor")
    return sensors[name]


def _measurements(log: Log, config: EstimatorConfig) -> StampedPoses:
    stamps_ns, poses, covariances = [], [], []
    last = "no frame"
    for output in estimator_outputs(log, config):
        measured = output.measured
        if measured is not None and measured.T_sensor_target is not None:
            stamps_ns.append(output.status.stamp_ns)
            poses.append(measured.T_sensor_target)
            covariances.append(measured.covariance)
        last = output.status.reason or last
    if not poses:
        raise CalibrationError(f"{log.paths[0].name}: the target was never tracked; the last reason: {last}")
    return _stamped(stamps_ns, poses, covariances)


def _estimates(log: Log, sensor: Sensor) -> StampedPoses:
    name = log.paths[0].name
    if sensor.T_chaser_sensor is None:
        raise CalibrationError(
            f"{name}: estimates, but not the mount of {sensor.name!r} that they assumed; give an estimator's "
            "configuration with --config"
        )
    prefix = estimate_prefix(log)
    topic = STATUS.under(prefix)
    used = {
        status.stamp_ns for status in log.statuses(topic) if status.accepted and status.sensor == sensor.name
    }
    found = [entry for entry in log.odometry(ESTIMATE.under(prefix)) if entry.stamp_ns in used]
    if not found:
        raise CalibrationError(
            f"{name}: neither an estimator's configuration nor estimates from {sensor.name!r}; give an "
            "estimator's with --config"
        )
    T_sensor_chaser = sensor.T_chaser_sensor.inv()
    turn = np.kron(np.eye(2), T_sensor_chaser.rotation.as_matrix())
    return _stamped(
        [entry.stamp_ns for entry in found],
        [T_sensor_chaser * entry.pose for entry in found],
        [turn @ entry.pose_covariance @ turn.T for entry in found],
    )


def _truth(log: Log) -> StampedPoses:
    name = log.paths[0].name
    stamps, entries = StampCheck(log), []
    for logged in log.messages(TRUTH):
        with log.unreadable.left_out(logged):
            entry = read_odometry(logged.decode())
            stamps.check(logged, entry.stamp_ns)
            entries.append(entry)
    if not entries:
        raise NoTruthError(name, TRUTH.name)
    if foreign := {entry.frame_id for entry in entries} - {CHASER}:
        raise CalibrationError(f"{name}: the truth is in frame {foreign.pop()!r}, not {CHASER!r}")
    return _stamped(
        [entry.stamp_ns for entry in entries],
        [entry.pose for entry in entries],
        [entry.pose_covariance for entry in entries],
    )


def _stamped(
    stamps_ns: list[int], poses: list[RigidTransform], covariances: Iterable[FloatArray]
) -> StampedPoses:
    matrices = np.stack([pose.as_matrix() for pose in poses])
    return StampedPoses(
        np.array(stamps_ns, np.int64), matrices[:, :3, :3], matrices[:, :3, 3], np.stack(list(covariances))
    ).in_order()
