"""A scenario: everything that a run needs, in one YAML or TOML file."""

from typing import Self

from pydantic import Field, model_validator

from rpod_schemas.config.base import Config, Name, Positive
from rpod_schemas.config.emulator import SensorConfig, WorldName
from rpod_schemas.config.estimator import EstimatorSettings
from rpod_schemas.config.motion import MotionConfig

DEFAULT_EPOCH_NS = 1_767_225_600_000_000_000
"""2026-01-01T00:00:00Z."""


class Scenario(Config):
    """A rendezvous to play."""

    name: Name
    """Under which ``rpod run`` finds it."""
    title: str = Field(min_length=8, max_length=120)
    """One line for ``rpod scenarios``."""
    target: str
    """Name or file of the target."""
    duration_s: Positive
    """Of the run."""
    seed: int = Field(default=1, ge=0)
    """Of all noise."""
    epoch_ns: int = Field(default=DEFAULT_EPOCH_NS, ge=0)
    """Start of time in lockstep; live runs start at the wall clock's time."""
    motion: MotionConfig
    """How chaser and target move."""
    sensors: tuple[SensorConfig, ...] = Field(min_length=1)
    """What is emulated."""
    world: WorldName = "documented"
    """Which physics the emulated sensors have; the estimator is not told."""
    publish_samples: bool = False
    """Publish the PMD cameras' raw samples as well: about 70 MB/s at 45 Hz."""
    estimator: EstimatorSettings
    """How poses are estimated."""

    @model_validator(mode="after")
    def _estimator_hears_the_sensors(self) -> Self:
        emulated = {(sensor.kind, sensor.name) for sensor in self.sensors}
        if len({name for _, name in emulated}) < len(self.sensors):
            raise ValueError("sensors: two have the same name")
        for sensor in self.estimator.sensors:
            if (sensor.kind, sensor.name) not in emulated:
                raise ValueError(f"estimator.sensors: no {sensor.kind} called {sensor.name!r} is emulated")
        return self
