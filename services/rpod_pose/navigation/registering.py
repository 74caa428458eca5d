"""Registration of frames from predicted poses, by the methods of their sensors."""

from collections.abc import Mapping
from math import radians

import numpy as np

from rpod_pose.belief import Angle
from rpod_pose.measurement import Measurement
from rpod_pose.navigation.filter import ATTITUDE, FilterState
from rpod_pose.navigation.first_pose.searches import Near, Search, expecting
from rpod_pose.navigation.frames import as_of_stamp
from rpod_pose.navigation.joints import JointTrack
from rpod_pose.ports import Methods, Registration
from rpod_schemas.poses import chained


class Registrar:
    """Registers frames by the methods of each sensor.

    Args:
        methods: methods of each sensor, by its name.
        vague_deg: standard deviation of the predicted attitude above which attitudes near it are searched.
    """

    def __init__(self, methods: Mapping[str, Methods], *, vague_deg: float) -> None:
        self._methods, self._vague_deg = methods, vague_deg

    def methods_for(self, joints: Mapping[str, JointTrack], event: Measurement) -> Methods:
        """Return the sensor's methods, which expect the joints' angles that their tracks predict."""
        return expecting(self._methods[event.sensor], self.angles(joints, event))

    def angles(self, joints: Mapping[str, JointTrack], event: Measurement) -> dict[str, Angle]:
        """Return the angles that the tracks of the target's joints predict for a frame."""
        return {name: track.at(event.stamp_ns).angle for name, track in joints.items()}

    def register(
        self, joints: Mapping[str, JointTrack], event: Measurement, predicted: FilterState, *, tracked: bool
    ) -> tuple[Registration, str]:
        """Return the registration from the prediction, and the reason why it is not used; empty if it is.

        Args:
            joints: tracks of the target's joints.
            event: the measurement.
            predicted: the prediction to its stamp.
            tracked: whether the sensor continues a track. To begin one, the belief must be stronger.
        """
        methods = self.methods_for(joints, event)
        T_sensor_target = chained(event.T_chaser_sensor.inv(), predicted.T_chaser_target)
        registration = methods.tracker.track(as_of_stamp(event, predicted, methods.deskew), T_sensor_target)
        enough = registration.continues_track if tracked else registration.begins_track
        return registration, "" if enough else registration.belief.refusal

    def around(self, joints: Mapping[str, JointTrack], event: Measurement, predicted: FilterState) -> Search:
        """Return the search of a frame near its prediction only."""
        deskew = self.methods_for(joints, event).deskew
        T_sensor_target = chained(event.T_chaser_sensor.inv(), predicted.T_chaser_target)
        near = Near(as_of_stamp(event, predicted, deskew), T_sensor_target)
        return Search(event, near=near, angles=self.angles(joints, event))

    def is_confident(self, predicted: FilterState) -> bool:
        """Return whether the predicted attitude is so well known that no search near it is needed."""
        sigma_rad = float(np.sqrt(np.linalg.eigvalsh(predicted.covariance[ATTITUDE, ATTITUDE])[-1]))
        return sigma_rad <= radians(self._vague_deg)
