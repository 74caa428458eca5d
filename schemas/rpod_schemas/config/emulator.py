"""The sensor emulator's and the motion service's configuration."""

from typing import Annotated, Literal, Self

from pydantic import Field, field_validator, model_validator

from rpod_schemas.config.base import Config, Name, NonNegative, Positive
from rpod_schemas.config.motion import TRUTH_RATE_HZ, JointMotionConfig, MotionConfig, TruthErrorConfig
from rpod_schemas.config.sensor import DISTINCT, EmulatedSensor
from rpod_schemas.config.service import ServiceConfig
from rpod_schemas.config.surroundings import Thing
from rpod_schemas.faults import PlannedFault
from rpod_schemas.sensors.fields import EMULATED

SensorConfig = Annotated[EmulatedSensor, EMULATED]
"""A sensor to emulate; ``kind`` chooses among the installed ones."""


WorldName = Literal[
    "documented", "lambertian", "noisy", "multipath", "faint",
    "specular", "stray-light", "exchanged", "keen", "outliers",
]  # fmt: skip
"""Name of a variant of the emulated physics; ``rpod_sim_sensor.worlds`` describes each."""


class EmulatorConfig(ServiceConfig):
    """Configuration of the sensor emulator: it receives the truth and publishes sensor messages."""

    instance: Name = "emulator"
    """Name on the bus."""
    target: str
    """Name or file of the target."""
    sensors: Annotated[tuple[SensorConfig, ...], DISTINCT] = Field(min_length=1)
    """Sensors to emulate."""
    joints: dict[str, JointMotionConfig] = Field(default_factory=dict)
    """Motion of the target's joints, by name, as the motion service has it."""
    world: WorldName = "documented"
    """Variant of the sensors' physics; neither the sensors' messages nor the estimator's configuration state
    it."""
    surroundings: tuple[Thing, ...] = ()
    """Things that the sensors see beside the target: walls, a stand, an arm."""
    seed: int = Field(default=0, ge=0)
    """Seed of all noise; seed and frame number together determine the noise of a frame."""
    epoch_ns: int | None = Field(default=None, ge=0)
    """Time from which frames are numbered, ns of UTC; the first truth's stamp if left out."""
    await_start: bool = False
    """Whether to begin only on the ``start`` query, which also gives the epoch."""
    publish_samples: bool = False
    """Whether to publish the PMD camera's raw samples as well."""
    motion: Literal["truth/odometry", "motion/reference"] = "truth/odometry"
    """Topic of the target's motion. ``motion/reference`` is the motion service's own, without the errors of
    the truth that it publishes (``truth_error``)."""
    faults: tuple[PlannedFault, ...] = ()
    """Faults of the sensors, at times from the epoch."""

    @field_validator("faults")
    @classmethod
    def _are_of_sensors(cls, faults: tuple[PlannedFault, ...]) -> tuple[PlannedFault, ...]:
        for fault in faults:
            if not fault.kind.of_sensor:
                raise ValueError(f"{fault.fault} is no fault of a sensor; plan it in a scenario instead")
        return faults


class LockstepConfig(Config):
    """Services for which the motion service waits in lockstep, when it owns time (ICD section 4)."""

    estimator: Name = "estimator"
    """Name of the estimator, whose status ends a frame."""
    answered: tuple[Name, ...] | None = None
    """Names of the sensors whose frames the estimator answers with a status; all if null."""
    emulator: Name = "emulator"
    """Name of the emulator; for a sensor that the estimator does not use, its count of published frames is
    awaited."""
    logger: Name | None = "logger"
    """Name of the logger, whose count of received messages is awaited; no logger if null."""
    timeout_s: Positive = 600.0
    """Longest wait for a service, s; after it the run ends with an error that names the service. A search
    without a guess takes minutes on a loaded machine. The supervisor reports a service that has ended at
    once."""


class MotionServiceConfig(ServiceConfig):
    """Configuration of the motion service, which publishes the truth."""

    instance: Name = "motion"
    """Name on the bus."""
    target: str
    """Name or file of the target; only its mass properties are used."""
    motion: MotionConfig
    """Motion of chaser and target."""
    duration_s: Positive
    """Duration of the scenario, s."""
    rate_hz: Positive = TRUTH_RATE_HZ
    """Rate of the truth, Hz."""
    truth_error: TruthErrorConfig | None = None
    """Errors of the published truth; exact if left out. ``motion/reference`` is always exact."""
    seed: int = Field(default=0, ge=0)
    """Seed of these errors."""
    epoch_ns: int | None = Field(default=None, ge=0)
    """Start of the scenario, ns of UTC. If left out, the ``start`` query gives it, or it is the time at which
    the service is ready."""
    await_start: bool = False
    """Whether to begin only on the ``start`` query."""
    speed: Literal["1", "max"] = "1"
    """Pace of time: 1 follows the wall clock, max is lockstep with the other services."""
    sensors: Annotated[tuple[SensorConfig, ...], DISTINCT] = ()
    """Sensors for whose frames lockstep waits."""
    lockstep: LockstepConfig = LockstepConfig()
    """Services for which lockstep waits."""
    preroll_s: float = Field(default=0.1, ge=0.0, le=0.9)
    """Time before the epoch from which truth is published, s; exposures around the epoch need it. The motion
    is defined from a second before the epoch on."""
    lead_s: NonNegative = 0.02
    """Longest time before its stamp at which truth is published on the wall clock, s: emulated sensors
    are then ready when real ones would be. Ticks within half of it are published together. No effect in
    lockstep."""

    @model_validator(mode="after")
    def _rates_divide_that_of_the_truth(self) -> Self:
        self.motion.check_rates(self.rate_hz)
        return self
