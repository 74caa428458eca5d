"""Random satellites: a population on which methods are measured, in place of a few bodies that are known.

A satellite is determined by its population, its seed and its number, and so is every byte of its files. There
are two populations that share no satellite: from ``derive`` limits may be derived, ``report`` is for reported
figures only.

``load_target("random-report-7-3")`` builds satellite 3 of seed 7; with ``-small`` at the end of the
name its longest side is 0.2 to 3 m in place of 0.2 to 60 m.
"""

from rpod_target.modelling.materials import MATERIALS
from rpod_target.population.names import POPULATIONS, PopulationName, name_of
from rpod_target.population.satellite import RandomSatellite, random_satellite, satellite_of

__all__ = [
    "MATERIALS",
    "POPULATIONS",
    "PopulationName",
    "RandomSatellite",
    "name_of",
    "random_satellite",
    "satellite_of",
]
