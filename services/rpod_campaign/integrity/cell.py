"""Cell of the campaign ``integrity``."""

from dataclasses import dataclass, field

from rpod_campaign.integrity.faults import BY_NAME
from rpod_campaign.sequences.course import PMD_HZ, fault_start_s
from rpod_schemas.config.emulator import WorldName


@dataclass(frozen=True)
class IntegrityCell:
    """A fault of a size, for a target and the sensors that see it."""

    fault: str
    size: float
    """Size in the fault's unit."""
    target: str
    sensor: str
    """``lidar``, ``pmd``, or ``both``."""
    world: WorldName = "documented"
    camera_hz: float = PMD_HZ
    """Rate of the camera."""
    document: str = field(default="", repr=False)
    """JSON of the scenario with the camera; empty for the LIDAR alone."""

    @property
    def start_s(self) -> float:
        """Time in the sequence at which the fault begins, s."""
        return 0.0 if BY_NAME[self.fault].lasting else fault_start_s(self.sensor)
