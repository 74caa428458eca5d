"""A sequence of images under one sun."""

from dataclasses import dataclass

from rpod_campaign.pmd.sequence import SCHEMA, SequenceCell, run

__all__ = ["SCHEMA", "SunCell", "run"]


@dataclass(frozen=True)
class SunCell(SequenceCell):
    """A sequence under a sun; ``case`` is the material that covers the mock-up."""

    angle_deg: float = 0.0
    """Angle between the direction to the sun and the boresight, deg; at 0 the camera looks into the sun."""
    azimuth_deg: float = 0.0
    """Azimuth about the boresight, from x (right) to y (down), deg."""
