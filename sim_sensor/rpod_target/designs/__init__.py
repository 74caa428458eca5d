"""Detailed targets that are built from their dimensions: the program behind some of the shipped files.

``python -m rpod_target.designs FOLDER`` writes the parameter files and mesh files of all of them. Another
variant is one call: ``Envisat(array_angle_deg=60.0).design().write(folder)``.
"""

from rpod_target.designs.design import Design
from rpod_target.designs.envisat import Envisat
from rpod_target.designs.telecom import Telecom
from rpod_target.designs.upper_stage import UpperStage

__all__ = ["Design", "Envisat", "Telecom", "UpperStage", "designs"]


def designs() -> tuple[Design, ...]:
    """Return the designs that are shipped."""
    return Envisat().design(), Telecom().design(), UpperStage().design()
