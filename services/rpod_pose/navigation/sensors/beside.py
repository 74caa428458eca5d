"""How a sensor's poses may differ from the track that another sensor began: as far as is declared.

Mounts, clocks and ranges of two sensors are declared to be right within some standard deviations. So a pose
of the second sensor differs from the track of the first by an error that lasts: 8 mm at 12 m along the line
of sight by ranges that are right to 0.05 % each. Two sensors that know their poses to 1 mm would contradict
each other although both are as good as declared. Therefore a sensor that comes to a track has a block of
states, the differences of these errors of two sensors. The filter estimates them with the declared standard
deviation as the prior. So the track stays in the frame of the sensor that began it.

Where the configuration has mounts as states (``filter.mount_sigma_deg``), these stand for the differences.
"""

from dataclasses import replace
from math import sqrt

from rpod_pose.navigation.filter import FilterState
from rpod_pose.navigation.integrity.levels import declared_errors
from rpod_pose.navigation.pose_measurement import PoseMeasurement, beside_of
from rpod_schemas.config.estimator import EstimatorSettings


class Beside:
    """Declared differences of sensors from the track that another one began.

    Args:
        settings: settings of the estimator.
    """

    def __init__(self, settings: EstimatorSettings) -> None:
        self._declared = settings.integrity
        self._by_states = bool(settings.filter.mount_sigma_deg or settings.filter.mount_sigma_m)

    def newcomer(self, measured: PoseMeasurement, predicted: FilterState) -> PoseMeasurement:
        """Return a newcomer's pose with its declared differences from the track.

        Args:
            measured: the pose.
            predicted: the prediction to its stamp.
        """
        if self._by_states or measured.origin is None:
            return measured
        place_m = predicted.T_chaser_target.translation - measured.origin.T_chaser_sensor.translation
        twist = predicted.velocity_m_s, predicted.rate_rad_s
        return replace(measured, declared=sqrt(2.0) * declared_errors(self._declared, place_m, *twist))

    def known(self, measured: PoseMeasurement, predicted: FilterState) -> PoseMeasurement:
        """Return a pose with its declared differences if its sensor has come to the track as a newcomer."""
        if measured.origin is None or beside_of(measured.origin.sensor) not in predicted.places():
            return measured
        return self.newcomer(measured, predicted)
