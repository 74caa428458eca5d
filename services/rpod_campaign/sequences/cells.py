"""The scenario of a sequence's camera, for the cells of campaigns."""

from rpod_campaign.pmd.cells import calibrated, scenarios
from rpod_campaign.pmd.options import PmdOptions
from rpod_schemas.config.emulator import WorldName
from rpod_schemas.config.scenario import Scenario

SCENARIO = "tumbling"
"""Scenario of the camera's sequences."""


def document_of(installed: dict[str, Scenario], sensor: str, target: str, world: WorldName) -> str:
    """Return the scenario of the calibrated camera, as JSON; empty for the LIDAR alone."""
    if sensor == "lidar":
        return ""
    own = PmdOptions(scenario=(SCENARIO,), target=(target,), world=(world,), scenarios=installed)
    ((_, scenario),) = scenarios(own)
    return calibrated(scenario).model_dump_json()
