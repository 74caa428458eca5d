"""The sensor emulator's and the motion service's configuration."""

from typing import Annotated, Literal

from pydantic import Field

from rpod_schemas.config.base import Config, Name, NonNegative, Positive
from rpod_schemas.config.motion import MotionConfig
from rpod_schemas.config.sensor import EmulatedSensor
from rpod_schemas.config.service import ServiceConfig
from rpod_schemas.sensors.fields import EMULATED

SensorConfig = Annotated[EmulatedSensor, EMULATED]
"""A sensor to emulate; ``kind`` chooses among the installed ones."""


WorldName = Literal[
    "documented", "lambertian", "noisy", "multipath", "faint",
    "specular", "stray-light", "exchanged", "keen", "outliers",
]  # fmt: skip
"""Variants of the physics behind the sensors' messages; ``rpod_sim_sensor.worlds`` says what each is."""


class EmulatorConfig(ServiceConfig):
    """Truth in, sensor messages out."""

    instance: Name = "emulator"
    """Name on the bus."""
    target: str
    """Name or file of the target."""
    sensors: tuple[SensorConfig, ...] = Field(min_length=1)
    """What is emulated."""
    world: WorldName = "documented"
    """Which physics the sensors have; they do not say it, and no estimator is told."""
    seed: int = Field(default=0, ge=0)
    """Of all noise; with a frame's number it gives that frame's noise."""
    epoch_ns: int | None = Field(default=None, ge=0)
    """From where frames are numbered; the first truth's stamp where left out."""
    await_start: bool = False
    """Begin only when the ``start`` query comes, which also says the epoch."""
    publish_samples: bool = False
    """Publish the PMD camera's raw samples as well."""


class LockstepConfig(Config):
    """For whom motion waits where it owns time (ICD section 4)."""

    estimator: Name = "estimator"
    """Whose status ends a frame."""
    answered: tuple[Name, ...] | None = None
    """Sensors whose frames the estimator answers with a status; all where null."""
    emulator: Name = "emulator"
    """Whose count of published frames is waited for where the estimator does not use a sensor."""
    logger: Name | None = "logger"
    """Whose count of received messages is waited for; nobody's where null."""
    timeout_s: Positive = 60.0
    """After which the run ends, naming the service."""


class MotionServiceConfig(ServiceConfig):
    """The truth and its pace."""

    instance: Name = "motion"
    """Name on the bus."""
    target: str
    """Name or file of the target; its mass properties matter here."""
    motion: MotionConfig
    """How chaser and target move."""
    duration_s: Positive
    """Of the scenario."""
    rate_hz: Positive = 250.0
    """Of the truth."""
    epoch_ns: int | None = Field(default=None, ge=0)
    """Start of the scenario; the ``start`` query, or the moment of being ready, where left out."""
    await_start: bool = False
    """Begin only when the ``start`` query comes."""
    speed: Literal["1", "max"] = "1"
    """By the wall clock, or in lockstep with the other services."""
    sensors: tuple[SensorConfig, ...] = ()
    """Whose frames lockstep waits for."""
    lockstep: LockstepConfig = LockstepConfig()
    """Whom lockstep waits for."""
    preroll_s: NonNegative = 0.1
    """Truth before the epoch, so that exposures around it are covered."""
    lead_s: NonNegative = 0.02
    """By the wall clock, truth is published so long before its stamp: so emulated sensors are ready when real
    ones would be. Not in lockstep."""
