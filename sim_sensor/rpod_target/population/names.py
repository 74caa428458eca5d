"""Names of the random satellites: population, seed and number."""

import re
from typing import Literal, NamedTuple, get_args

PopulationName = Literal["derive", "report"]
POPULATIONS: tuple[PopulationName, ...] = get_args(PopulationName)
_NAME = re.compile(r"random-(derive|report)-(\d{1,9})-(\d{1,9})(-small)?")


class SatelliteName(NamedTuple):
    """Content of a satellite's name."""

    population: PopulationName
    seed: int
    number: int
    small: bool
    """Whether its longest side is 0.2 to 3 m."""


def name_of(population: PopulationName, seed: int, index: int, *, small: bool = False) -> str:
    """Return the name of a satellite."""
    return f"random-{population}-{seed}-{index}{'-small' if small else ''}"


def parsed(name: str) -> SatelliteName | None:
    """Return what a name says; None for any other text."""
    found = _NAME.fullmatch(name)
    if found is None:
        return None
    population: PopulationName = "derive" if found[1] == "derive" else "report"
    return SatelliteName(population, int(found[2]), int(found[3]), bool(found[4]))
