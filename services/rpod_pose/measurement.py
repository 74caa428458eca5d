"""What the navigator is fed: a measurement of one sensor, or a bare tick of time."""

from dataclasses import dataclass

from scipy.spatial.transform import RigidTransform

from rpod_schemas.types import SensorFrame


@dataclass(frozen=True, eq=False)
class Measurement:
    """One frame of one sensor with its mount."""

    sensor: str
    data: SensorFrame
    T_chaser_sensor: RigidTransform

    @property
    def stamp_ns(self) -> int:
        """Middle of the exposure or scan."""
        return self.data.stamp_ns


@dataclass(frozen=True)
class Tick:
    """Time went by without a measurement."""

    stamp_ns: int
