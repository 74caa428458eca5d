"""From a scenario to the configurations of all services of a run."""

import secrets
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from rpod_runtime.session import free_endpoint
from rpod_schemas.config.emulator import EmulatorConfig, LockstepConfig, MotionServiceConfig
from rpod_schemas.config.estimator import EstimatorConfig, EstimatorSettings
from rpod_schemas.config.logger import LoggerConfig
from rpod_schemas.config.scenario import Scenario
from rpod_schemas.config.service import BusConfig, RouterConfig, ServiceConfig
from rpod_schemas.config.view import ViewConfig

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


def configure(scenario: Scenario, *, directory: Path, speed: Speed) -> Facility:
    """Return the configurations of a run's services; each run has its own endpoint and estimator identity."""
    endpoint = free_endpoint()
    bus = BusConfig(connect=endpoint, wait=True)
    estimator_id = secrets.token_hex(8).lstrip("0") or "e"
    time_source: Literal["wall", "clock"] = "clock" if speed == "max" else "wall"
    return Facility(
        router=RouterConfig(listen=endpoint, estimators=(estimator_id,)),
        services={
            "motion": MotionServiceConfig(
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
            ),
            "emulator": EmulatorConfig(
                bus=bus,
                target=scenario.target,
                sensors=scenario.sensors,
                joints=scenario.motion.joints,
                world=scenario.world,
                surroundings=scenario.surroundings,
                motion="truth/odometry" if scenario.truth_error is None else "motion/reference",
                seed=scenario.seed,
                publish_samples=scenario.publish_samples,
                faults=scenario.faults,
                await_start=True,
                time_source=time_source,
            ),
            "estimator": EstimatorConfig(
                bus=bus,
                zenoh_id=estimator_id,
                target=scenario.model,
                time_source=time_source,
                **_settings(scenario),
            ),
            "logger": LoggerConfig(bus=bus, directory=directory, name=scenario.name),
        },
        supervisor=ServiceConfig(
            instance="supervisor", bus=BusConfig(connect=endpoint, connect_timeout_s=_ROUTER_POLL_S)
        ),
        view=ViewConfig(bus=bus, target=scenario.target, truth="tf"),
    )


def _settings(scenario: Scenario) -> dict[str, Any]:
    """Return the estimator's settings with the sensors' infos, so that it warms up before they are sent."""
    emulated = {sensor.name: sensor for sensor in scenario.sensors}
    sensors = tuple(sensor.informed_by(emulated[sensor.name]) for sensor in scenario.estimator.sensors)
    shared = {name: getattr(scenario.estimator, name) for name in EstimatorSettings.model_fields}
    return shared | {"sensors": sensors}
