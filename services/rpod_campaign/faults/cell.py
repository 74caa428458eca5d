"""One cell of ``faults``: a fault of a size, for a time."""

from dataclasses import dataclass, field

from rpod_campaign.sequences.course import fault_start_s
from rpod_schemas.config.emulator import WorldName


@dataclass(frozen=True)
class FaultCell:
    """A fault of a size and a duration."""

    fault: str
    size: float | None
    """Size in the catalogue's unit; None if it has none."""
    lasts_s: float
    target: str
    sensor: str
    world: WorldName = "documented"
    document: str = field(default="", repr=False)
    """JSON of the camera's scenario; empty for the LIDAR."""

    @property
    def start_s(self) -> float:
        """Begin of the fault in the sequence, s."""
        return fault_start_s(self.sensor)

    @property
    def end_s(self) -> float:
        """End of the fault in the sequence, s; a LIDAR's lasts ten times as long, since it has 1 Hz."""
        return self.start_s + (10.0 * self.lasts_s if self.sensor == "lidar" else self.lasts_s)
