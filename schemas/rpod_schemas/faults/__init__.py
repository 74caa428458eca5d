"""The catalogue of faults: the same one for injection, scenarios, campaigns and checks.

``rpod_sim_sensor.faults`` injects those of sensors, the proxy those of links, the supervisor those of
processes, the logger that of its disk. Scenarios and queries ask for them by name, campaigns try them, and
``rpod driver check`` names those of sensors. ``docs/reference/faults.md`` of the site is made from it.
"""

from rpod_schemas.faults.facility import FACILITY_FAULTS
from rpod_schemas.faults.fault import BOTH, Evidence, Fault, Size
from rpod_schemas.faults.planned import ALL_FAULTS, BY_NAME, AskedFault, FaultName, PlannedFault, known_fault
from rpod_schemas.faults.sensor import FAULTS

__all__ = [
    "ALL_FAULTS", "BOTH", "BY_NAME", "FACILITY_FAULTS", "FAULTS", "AskedFault", "Evidence", "Fault",
    "FaultName", "PlannedFault", "Size", "known_fault",
]  # fmt: skip
