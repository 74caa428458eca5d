"""From a scenario to the configurations of all services of a run."""

import secrets
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from rpod_runtime.bus.session import free_endpoint
from rpod_schemas.config.emulator import EmulatorConfig, LockstepConfig, MotionServiceConfig
from rpod_schemas.config.estimator import EstimatorConfig
from rpod_schemas.config.facility.logger import LoggerConfig
from rpod_schemas.config.facility.proxy import ProxiedLink, ProxyConfig
from rpod_schemas.config.facility.view import ViewConfig
from rpod_schemas.config.scenario import Scenario
from rpod_schemas.config.service import BusConfig, RouterConfig, ServiceConfig, TimeSource
from rpod_schemas.errors import ConfigurationError

Speed = Literal["1", "max"]
_ROUTER_POLL_S = 0.5
"""Interval at which the supervisor checks that the router still runs while it tries to reach it."""


@dataclass(frozen=True)
class Facility:
    """Configurations of all services, and that of the supervisor's own client."""

    router: RouterConfig
    services: dict[str, ServiceConfig]
    """Configurations by verb, in the order in which services stop: publishers before their receivers."""
    supervisor: ServiceConfig
    view: ViewConfig
    """Configuration of the live view, if one is wanted."""
    proxy: ProxyConfig | None = None
    """Configuration of the proxy, if the scenario has faults of links."""


def configure(scenario: Scenario, *, directory: Path, speed: Speed) -> Facility:
    """Return the configurations of a run's services; each run has its own endpoint and estimator identity."""
    endpoint = free_endpoint()
    bus = BusConfig(connect=endpoint, wait=True, link=scenario.link)
    estimator_id = secrets.token_hex(8).lstrip("0") or "e"
    _check_faults(scenario, speed)
    time_source: TimeSource = "clock" if speed == "max" else "wall"
    facility = Facility(
        router=RouterConfig(listen=endpoint, estimators=(estimator_id,), link=scenario.link),
        services={
            "motion": _motion(scenario, bus, speed),
            "emulator": _emulator(scenario, bus, time_source),
            "estimator": EstimatorConfig(
                bus=bus,
                zenoh_id=estimator_id,
                target=scenario.model,
                time_source=time_source,
                **dict(scenario.settings),
            ),
            "logger": LoggerConfig(
                bus=bus, directory=directory, name=scenario.name, record_extra=_reduced_rate(scenario, bus)
            ),
        },
        supervisor=ServiceConfig(
            instance="supervisor", bus=BusConfig(connect=endpoint, connect_timeout_s=_ROUTER_POLL_S)
        ),
        view=ViewConfig(bus=bus, target=scenario.target, truth="tf"),
    )
    return _with_proxy(facility, scenario)


def _motion(scenario: Scenario, bus: BusConfig, speed: Speed) -> MotionServiceConfig:
    return MotionServiceConfig(
        bus=bus,
        target=scenario.target,
        motion=scenario.motion,
        duration_s=scenario.duration_s,
        truth_error=scenario.truth_error,
        seed=scenario.seed,
        sensors=scenario.sensors,
        await_start=True,
        speed=speed,
        lockstep=LockstepConfig(answered=tuple(sensor.name for sensor in scenario.estimator.sensors)),
    )


def _emulator(scenario: Scenario, bus: BusConfig, time_source: TimeSource) -> EmulatorConfig:
    return EmulatorConfig(
        bus=bus,
        target=scenario.target,
        sensors=scenario.sensors,
        joints=scenario.motion.joints,
        world=scenario.world,
        surroundings=scenario.surroundings,
        motion="truth/odometry" if scenario.truth_error is None else "motion/reference",
        seed=scenario.seed,
        publish_samples=scenario.publish_samples,
        faults=tuple(fault for fault in scenario.faults if fault.kind.of_sensor),
        await_start=True,
        time_source=time_source,
    )


def _check_faults(scenario: Scenario, speed: Speed) -> None:
    """Raise ``ConfigurationError`` for faults of links, processes or the disk in lockstep.

    Lockstep waits for all services.
    """
    others = [fault.fault for fault in scenario.faults if not fault.kind.of_sensor]
    if speed == "max" and others:
        raise ConfigurationError(
            scenario.name, "faults", f"{others[0]} needs the wall clock: run it with --speed 1"
        )


def _with_proxy(facility: Facility, scenario: Scenario) -> Facility:
    """Return the facility with a proxy in the links that are to be faulty."""
    names = {fault.service for fault in scenario.faults if fault.kind.subject == "link" and fault.service}
    if not names:
        return facility
    target = facility.router.listen.split("/", 1)[1]
    links = {name: ProxiedLink(listen=free_endpoint().split("/", 1)[1], target=target) for name in names}
    services = dict(facility.services)
    for name, link in links.items():
        bus = services[name].bus.model_copy(update={"connect": f"tcp/{link.listen}"})
        services[name] = services[name].model_copy(update={"bus": bus})
    proxy = ProxyConfig(
        bus=BusConfig(connect=facility.router.listen, wait=True), links=links, seed=scenario.seed
    )
    return replace(facility, services=services, proxy=proxy)


def _reduced_rate(scenario: Scenario, bus: BusConfig) -> tuple[str, ...]:
    """Return the keys of the sensors' streams of reduced rate, which are recorded too."""
    configs = {sensor.name: getattr(sensor, "reduced_rate", None) for sensor in scenario.sensors}
    return tuple(f"{bus.keys.root}/{each.prefix}/{name}/**" for name, each in configs.items() if each)
