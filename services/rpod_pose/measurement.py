"""Input of the navigator: a measurement of one sensor, or a tick of time without one."""

from dataclasses import dataclass

from scipy.spatial.transform import RigidTransform

from rpod_schemas.types import SensorFrame


@dataclass(frozen=True, eq=False)
class Measurement:
    """One frame of one sensor with its mount."""

    sensor: str
    """Name of the sensor."""
    data: SensorFrame
    """The frame, in sensor axes."""
    T_chaser_sensor: RigidTransform
    """Mount of the sensor."""

    @property
    def stamp_ns(self) -> int:
        """Stamp of the middle of the exposure or scan, ns of UTC."""
        return self.data.stamp_ns


@dataclass(frozen=True)
class Tick:
    """A time up to which no measurement has arrived."""

    stamp_ns: int
