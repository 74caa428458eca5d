"""``navigation``: its cells, and the campaign as one object."""

from dataclasses import replace
from typing import Any

from rpod_campaign.engine.campaign import Campaign
from rpod_campaign.engine.trial.targets import cached_target
from rpod_campaign.lidar.cells import targets
from rpod_campaign.navigation import trial
from rpod_campaign.navigation.options import Options
from rpod_campaign.navigation.report import sections, summarise
from rpod_campaign.navigation.trial import FRAME, NavigationCell
from rpod_campaign.pmd.cells import approaching, calibrated
from rpod_campaign.pmd.world import NOMINAL, World
from rpod_campaign.pmd_robustness.campaign import case_ranges_m
from rpod_campaign.pmd_robustness.trial import CASES
from rpod_schemas.config.base import check
from rpod_schemas.config.emulator import WorldName
from rpod_schemas.config.scenario import Scenario
from rpod_schemas.errors import ConfigurationError


def cells(options: Options) -> list[NavigationCell]:
    """Return the cells. Raises ConfigurationError, which names the option."""
    return [
        NavigationCell(
            scenario=scenario.name,
            target=cached_target(target).name,
            seconds=min(options.seconds, scenario.duration_s),
            off_mm=off_mm,
            misbuilt=misbuilt,
            declared=declared,
            world=world,
            rate_hz=rate_hz,
            mounts=mounts,
            motion=motion,
            case=case,
            pixels=_pixels(case),
            document=_document(_in_case(scenario, target, case), target, world, rate_hz),
        )
        for scenario in (_found(options, name) for name in options.scenario)
        for target in targets(options.target or (scenario.target,))
        for case in options.case
        for world in options.world
        for rate_hz in _rates(options, scenario)
        for mounts in options.mounts
        for motion in options.motion
        for off_mm in _off_mm(options, case)
        for misbuilt in (options.misbuilt if off_mm else ("parts",))
        for declared in (options.declared if off_mm else (1.0,))
    ]


def _in_case(scenario: Scenario, target: str, case: str) -> Scenario:
    """Return a scenario with the cameras' calibration and the range of a case of ``pmd-robustness``."""
    if case not in CASES:
        return scenario
    if not any(sensor.kind == "pmd" for sensor in scenario.sensors):
        raise ConfigurationError("--case", "", f"{case!r} needs a camera, which {scenario.name} has not")
    seen = calibrated(scenario).model_copy(update={"target": target})
    return approaching(seen, case_ranges_m(seen, CASES[case]))


def _pixels(case: str) -> World:
    """Return the pixels that the cameras lose in a case; its other errors are the cell's own."""
    return replace(CASES[case].world, cad_error_m=0.0) if case in CASES else NOMINAL


def _off_mm(options: Options, case: str) -> tuple[float, ...]:
    """Return how far targets are off in a case, mm; those of the options in the scenario as it is."""
    return (1e3 * CASES[case].world.cad_error_m,) if case in CASES else options.off_mm


def _rates(options: Options, scenario: Scenario) -> tuple[float | None, ...]:
    """Return the rates of the scenario's cameras, Hz; None for its own, and where there is no camera."""
    has_camera = any(sensor.kind == "pmd" for sensor in scenario.sensors)
    return (options.rate if has_camera else ()) or (None,)


def _found(options: Options, name: str) -> Scenario:
    """Return a scenario that can be played in one process."""
    scenario = options.scenarios.get(name)
    if scenario is None:
        known = ", ".join(options.scenarios)
        raise ConfigurationError("--scenario", "", f"needs the path of a YAML file, or {known}, not {name!r}")
    for has, what in (
        (scenario.faults, "faults (the campaign 'faults' plays such)"),
        (scenario.motion.joints, "joints that move"),
        (scenario.estimator.dynamics.imu, "an IMU of the chaser"),
        (scenario.estimator.dynamics.command, "commands of the chaser"),
    ):
        if has:
            reason = f"{name} has {what}, which this campaign does not play: give a copy of the file without"
            raise ConfigurationError("--scenario", "", reason)
    return scenario


def _document(scenario: Scenario, target: str, world: WorldName, rate_hz: float | None) -> str:
    """Return a scenario with another target, world and rate of its cameras, as JSON."""
    document: dict[str, Any] = scenario.model_dump(mode="json") | {"target": target, "world": world}
    for sensor in document["sensors"]:
        if rate_hz is not None and sensor["kind"] == "pmd":
            sensor["rate_hz"] = rate_hz
    return check(Scenario, document, source=scenario.name).model_dump_json()


CAMPAIGN: Campaign[NavigationCell] = Campaign(
    name="navigation",
    options=Options,
    cells=cells,
    trial=trial.run,
    schema=trial.SCHEMA,
    summarise=summarise,
    sections=sections,
    keys=(FRAME,),
)
