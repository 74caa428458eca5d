"""Cells of the camera's campaigns from the options that they share."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from rpod_campaign.engine.report.numbers import in_world
from rpod_campaign.engine.trial.sizes import in_metres
from rpod_campaign.engine.trial.surroundings import surroundings
from rpod_campaign.engine.trial.targets import cached_target, model_of
from rpod_campaign.pmd.framing import ranges_filling, reaching
from rpod_campaign.pmd.methods import has_radius, pmd_input
from rpod_campaign.pmd.options import PmdOptions
from rpod_campaign.pmd.scene import camera_of
from rpod_schemas.config.base import check
from rpod_schemas.config.motion import ApproachConfig
from rpod_schemas.config.pmd import PmdConfig
from rpod_schemas.config.scenario import Scenario
from rpod_schemas.errors import ConfigurationError
from rpod_target import TargetError

CALIBRATED_WIGGLING = 0.005
"""Share of the third harmonic h3 that remains after a calibration."""
_FAMILY = "mockup-"


def scenarios(
    options: PmdOptions, *, ranges: Sequence[float | str] | None = None
) -> Iterator[tuple[str, Scenario]]:
    """Yield the scenarios with a camera in each world and with each target, and their labels.

    ``mockup-`` may be left out of a name; a label names any world but the documented one, and any target but
    the scenario's own.

    Args:
        options: options of the campaign.
        ranges: ranges between which the target approaches; None for those of the scenario, or for another
            target those at which it fills 20 to 80 % of the image's height.

    Raises:
        ConfigurationError: a scenario is unknown, or a target cannot be loaded.
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
        for target in options.target or (known[short].target,):
            shown = _with_target(known[short], target, ranges)
            own = target == known[short].target
            label = short if own else f"{short} with {cached_target(target).name}"
            model = model_of(target, getattr(options, "model", None))
            estimator = shown.estimator.model_copy(update={"target": model or None})
            for world in options.world:
                for around in options.surroundings:
                    things = surroundings(around, cached_target(target), _span_m(options, shown, ranges))
                    update = {"world": world, "estimator": estimator, "surroundings": things}
                    yield in_world(label, world, around), shown.model_copy(update=update)


def _span_m(
    options: PmdOptions, scenario: Scenario, ranges: Sequence[float | str] | None
) -> tuple[float, float]:
    """Return the least and the greatest range of a campaign's trials, m."""
    trajectory = scenario.motion.trajectory
    if hasattr(options, "ranges") and (ranges or not isinstance(trajectory, ApproachConfig)):
        return ranges_m(ranges, scenario)
    if getattr(options, "ranges", None) is not None:
        return ranges_m(chosen(options, scenario), scenario)
    assert isinstance(trajectory, ApproachConfig)  # noqa: S101 - of all scenarios with a camera
    ends_m = [float(np.linalg.norm(end_m)) for end_m in (trajectory.start_m, trajectory.end_m)]
    return min(ends_m), max(ends_m)


def ranges_m(ranges: Sequence[float | str] | None, scenario: Scenario) -> tuple[float, float]:
    """Return the least and the greatest of some ranges, m.

    Without any, they are those at which the scenario's target fills 80 and 20 % of the image's height.
    """
    target = cached_target(scenario.target)
    if ranges is None:
        return ranges_filling(target, camera_of(scenario))
    lengths_m = in_metres(ranges, target)
    return min(lengths_m), max(lengths_m)


def chosen(options: PmdOptions, scenario: Scenario) -> tuple[float | str, ...] | None:
    """Return the ranges of a campaign's option; None to let another target fill 20 to 80 % of the image."""
    ranges: tuple[float | str, ...] = getattr(options, "ranges")  # noqa: B009 - not every campaign has it
    own = options.scenarios[scenario.name].target == scenario.target
    return ranges if own or "ranges" in options.model_fields_set else None


def approaching(scenario: Scenario, range_m: tuple[float, float]) -> Scenario:
    """Return a scenario with a straight approach from one range to another, m."""
    document: dict[str, Any] = scenario.model_dump(mode="json")
    start_m, end_m = range_m
    document["motion"]["trajectory"] |= {"start_m": [0.0, 0.0, start_m], "end_m": [0.0, 0.0, end_m]}
    return check(Scenario, document, source=scenario.name)


def _with_target(scenario: Scenario, target: str, ranges: Sequence[float | str] | None) -> Scenario:
    """Return a scenario with another target, or with other ranges, on a straight approach."""
    if target == scenario.target and ranges is None:
        return scenario
    try:
        cached_target(target)
    except TargetError as error:
        raise ConfigurationError("--target", "", str(error)) from error
    document: dict[str, Any] = scenario.model_dump(mode="json")
    document["target"], document["estimator"]["initial_pose"] = target, None
    shown = check(Scenario, document, source=scenario.name)
    near_m, far_m = ranges_m(ranges, shown)
    if near_m == far_m:
        reason = f"is {near_m:g} m alone; it needs two ranges, between which the target approaches"
        raise ConfigurationError("--ranges", "", reason)
    return approaching(reaching(shown, far_m), (far_m, near_m))


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
        raise ConfigurationError("--radius", "", f"has no meaning for {', '.join(names)}; leave it out")
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
