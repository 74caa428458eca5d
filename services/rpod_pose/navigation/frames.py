"""Conversion of measurements from a sensor's axes and times to those of the filter."""

from math import inf

import numpy as np
from scipy.spatial.transform import RigidTransform

from rpod_pose.measurement import Measurement
from rpod_pose.navigation.filter import FilterState
from rpod_pose.navigation.pose_measurement import Origin, PoseMeasurement
from rpod_pose.navigation.sensors.streams import Stream
from rpod_pose.ports import Deskew, Registration
from rpod_schemas.arrays import FloatArray
from rpod_schemas.poses import chained, rotation_matrix
from rpod_schemas.types import SensorFrame


def as_of_stamp(measurement: Measurement, predicted: FilterState, deskew: Deskew | None) -> SensorFrame:
    """Return the frame at its stamp: de-skewed with the predicted twist if the sensor kind needs it.

    Before the second frame the predicted twist is zero, and the frame stays as it is.
    """
    if deskew is None:
        return measurement.data
    T_sensor_chaser = measurement.T_chaser_sensor.inv()
    R_sensor_chaser = rotation_matrix(T_sensor_chaser)
    deskewed: SensorFrame = deskew(
        measurement.data,
        chained(T_sensor_chaser, predicted.T_chaser_target),
        velocity_m_s=R_sensor_chaser @ predicted.velocity_m_s,
        rate_rad_s=R_sensor_chaser @ predicted.rate_rad_s,
    )
    return deskewed


def as_measured(
    registration: Registration, event: Measurement, stream: Stream | None = None
) -> PoseMeasurement:
    """Return the pose of a registration in the chaser's axes, at the frame's stamp.

    Args:
        registration: a registration with a pose.
        event: the frame.
        stream: earlier frames of its sensor; None if errors that successive frames share do not matter.
    """
    return PoseMeasurement(
        event.stamp_ns,
        *in_chaser(registration, event.T_chaser_sensor),
        Origin(event.sensor, event.T_chaser_sensor, registration.parts),
        since_s=inf if stream is None else stream.since_s(event.stamp_ns),
        lasting_s=event.data.lasting_s,
    )


def in_chaser(
    registration: Registration, T_chaser_sensor: RigidTransform
) -> tuple[RigidTransform, FloatArray]:
    """Return T_chaser_target of a registration, and its covariance in chaser axes, (6, 6) (ICD section 1)."""
    assert registration.T_sensor_target is not None  # noqa: S101 - guaranteed by the caller
    R = rotation_matrix(T_chaser_sensor)
    turn = np.zeros((6, 6))
    turn[:3, :3] = turn[3:, 3:] = R
    return chained(T_chaser_sensor, registration.T_sensor_target), turn @ registration.covariance @ turn.T
