"""Cells of the camera's campaigns from the options that they share."""

from collections.abc import Iterator
from typing import Any

from rpod_campaign.engine.report.numbers import in_world
from rpod_campaign.pmd.methods import has_radius, pmd_input
from rpod_campaign.pmd.options import PmdOptions
from rpod_schemas.config.base import check
from rpod_schemas.config.pmd import PmdConfig
from rpod_schemas.config.scenario import Scenario
from rpod_schemas.errors import ConfigurationError

CALIBRATED_WIGGLING = 0.005
"""Share of the third harmonic h3 that remains after a calibration."""
_FAMILY = "mockup-"


def scenarios(options: PmdOptions) -> Iterator[tuple[str, Scenario]]:
    """Yield the scenarios with a camera in each world, and their labels.

    ``mockup-`` may be left out of a name; a label names any world but the documented one.

    Raises:
        ConfigurationError: a scenario is unknown.
    """
    known = {
        name.removeprefix(_FAMILY): scenario
        for name, scenario in options.scenarios.items()
        if any(isinstance(sensor, PmdConfig) for sensor in scenario.sensors)
    }
    for name in options.scenario:
        short = name.removeprefix(_FAMILY)
        if short not in known:
            raise ConfigurationError("--scenario", "", f"needs {', '.join(known)}, not {name!r}")
        for world in options.world:
            scenario = known[short].model_copy(update={"world": world})
            yield in_world(short, world), scenario


def methods(
    names: tuple[str, ...], chosen_px: tuple[int, ...] | None = None, *, radii_px: tuple[int, ...] = (25,)
) -> Iterator[tuple[str, int | None]]:
    """Yield methods, each with its radii of the neighbour search, px, if it has one.

    Args:
        names: names of the methods.
        chosen_px: radii that the user chose, px.
        radii_px: radii if the user chose none, px.

    Raises:
        ConfigurationError: a method is unknown, or this version lacks it.
    """
    if chosen_px and not any(has_radius(method) for method in names):
        raise ConfigurationError("--radius", "", f"has no meaning for {', '.join(names)}")
    for method in names:
        for radius_px in (chosen_px or radii_px) if has_radius(method) else (None,):
            pmd_input(method, radius_px=radius_px)
            yield method, radius_px


def calibrated(scenario: Scenario) -> Scenario:
    """Return a scenario with calibrated cameras: with the remaining error, known to the estimator."""
    document: dict[str, Any] = scenario.model_dump(mode="json")
    hertz = {}
    for camera, sensor in zip(scenario.sensors, document["sensors"], strict=True):
        if isinstance(camera, PmdConfig):
            sensor["pixel"]["wiggling_share"] = CALIBRATED_WIGGLING
            hertz[camera.name] = camera.frequencies_hz
    for sensor in document["estimator"]["sensors"]:
        if sensor["kind"] == "pmd":
            sensor["calibration"] = {"modulation_frequency_hz": hertz[sensor["name"]]}
    return check(Scenario, document, source=scenario.name)
