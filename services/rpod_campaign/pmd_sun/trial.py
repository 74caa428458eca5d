"""A sequence of images under one sun."""

from dataclasses import dataclass

from rpod_campaign.pmd.sequence import SCHEMA, SequenceCell, run

__all__ = ["SCHEMA", "SunCell", "run"]


@dataclass(frozen=True)
class SunCell(SequenceCell):
    """A sequence under a sun; ``case`` is what covers the mock-up."""

    angle_deg: float = 0.0
    """Between the directions to the sun and of the boresight: at 0 the camera looks into the sun."""
    azimuth_deg: float = 0.0
    """About the boresight, from x (right) to y (down)."""
