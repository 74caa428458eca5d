"""A scenario: everything that a run needs, in one YAML or TOML file."""

from typing import Annotated, Self

from pydantic import Field, ValidationInfo, field_validator, model_validator

from rpod_schemas.config.base import Config, Name, Positive
from rpod_schemas.config.emulator import SensorConfig, WorldName
from rpod_schemas.config.estimator import EstimatorSettings
from rpod_schemas.config.estimator.estimator import HeardSensor
from rpod_schemas.config.facility.link import Link, LinkConfig
from rpod_schemas.config.motion import TRUTH_RATE_HZ, MotionConfig, TruthErrorConfig
from rpod_schemas.config.sensor import DISTINCT
from rpod_schemas.config.surroundings import Thing
from rpod_schemas.faults import PlannedFault

DEFAULT_EPOCH_NS = 1_767_225_600_000_000_000
"""Default epoch, 2026-01-01T00:00:00Z, ns of UTC."""


_CLIENTS = ("motion", "emulator", "estimator", "logger")
_MAY_FAIL = {
    "messages": (), "scene": (), "disk": (),
    "link": _CLIENTS,
    "process": ("router", *_CLIENTS),
}  # fmt: skip
"""Services of a run that can have a fault, by the fault's subject."""


class ScenarioEstimator(EstimatorSettings):
    """The estimator of a scenario."""

    sensors: Annotated[tuple[HeardSensor, ...], DISTINCT] = Field(default_factory=tuple, min_length=1)
    """Sensors that the estimator uses, each with its ``kind`` and its name in the scenario. If left out, it
    uses all of the scenario's, each with the default configuration of its kind."""
    target: str | None = None
    """Name or file of the target that the estimator looks for: its model of the real one, which may differ.
    Both share their axes. If left out, the model is the scenario's own target."""


class Scenario(Config):
    """A rendezvous to play."""

    name: Name
    """Name under which ``rpod run`` finds the scenario."""
    title: str = Field(min_length=1, max_length=120)
    """Title, one line for ``rpod scenarios``."""
    target: str
    """Name or file of the target that moves and that the sensors see."""
    duration_s: Positive
    """Duration of the run, s."""
    seed: int = Field(default=1, ge=0)
    """Seed of all noise."""
    epoch_ns: int = Field(default=DEFAULT_EPOCH_NS, ge=0)
    """Start of time in lockstep, ns of UTC; live runs start at the wall clock's time."""
    motion: MotionConfig
    """Motion of chaser and target, and the sun."""
    truth_error: TruthErrorConfig | None = None
    """Errors of the published truth, as of robots or motion capture, with their covariance; exact if left
    out. The sensors see the exact motion."""
    sensors: Annotated[tuple[SensorConfig, ...], DISTINCT] = Field(min_length=1)
    """Sensors to emulate."""
    world: WorldName = "documented"
    """Variant of the emulated sensors' physics; the estimator does not know it."""
    surroundings: tuple[Thing, ...] = ()
    """Things that the sensors see beside the target: walls, a stand, an arm; the truth stays the target's."""
    publish_samples: bool = False
    """Whether to publish the PMD cameras' raw samples as well, about 70 MB/s at 45 Hz."""
    faults: tuple[PlannedFault, ...] = ()
    """Faults of sensors, links, processes and the logger's disk, at times of the scenario, by their names in
    the catalogue; the estimator does not know of them."""
    link: Link = LinkConfig()
    """Tuning of all links to the router: ``fast``, ``slow``, or field by field."""
    estimator: ScenarioEstimator = Field(default_factory=ScenarioEstimator, validate_default=True)
    """Sensors, navigator and filter of the estimator, and the target that it looks for."""

    @model_validator(mode="after")
    def _rates_divide_that_of_the_truth(self) -> Self:
        self.motion.check_rates(TRUTH_RATE_HZ)
        return self

    @property
    def model(self) -> str:
        """Name or file of the target that the estimator looks for."""
        return self.estimator.target or self.target

    @property
    def settings(self) -> EstimatorSettings:
        """The estimator's settings with what the emulated sensors will state, so that it warms up before."""
        emulated = {sensor.name: sensor for sensor in self.sensors}
        heard = tuple(sensor.informed_by(emulated[sensor.name]) for sensor in self.estimator.sensors)
        shared = {name: getattr(self.estimator, name) for name in EstimatorSettings.model_fields}
        return EstimatorSettings(**(shared | {"sensors": heard}))

    @field_validator("estimator")
    @classmethod
    def _uses_all_if_it_names_none(
        cls, estimator: ScenarioEstimator, info: ValidationInfo
    ) -> ScenarioEstimator:
        if estimator.sensors or "sensors" not in info.data:  # where they are wrong, that is reported
            return estimator
        given = {name: getattr(estimator, name) for name in estimator.model_fields_set}
        heard = [{"kind": sensor.kind, "name": sensor.name} for sensor in info.data["sensors"]]
        return ScenarioEstimator.model_validate({**given, "sensors": heard})

    @model_validator(mode="after")
    def _estimator_hears_the_sensors(self) -> Self:
        emulated = {(sensor.kind, sensor.name) for sensor in self.sensors}
        for fault in self.faults:
            if fault.sensor not in {None, *(name for _, name in emulated)}:
                raise ValueError(
                    f"faults: no sensor {fault.sensor!r} is emulated; sensors has {self._emulated}"
                )
            if fault.service not in (None, *_MAY_FAIL[fault.kind.subject]):
                known = ", ".join(_MAY_FAIL[fault.kind.subject])
                raise ValueError(f"faults: {fault.fault} of {fault.service!r}, needs one of {known}")
            if fault.start_s >= self.duration_s:
                raise ValueError(
                    f"faults: {fault.fault} has start_s {fault.start_s:g}, and the scenario's duration_s is "
                    f"{self.duration_s:g}: begin it earlier, or let the scenario last longer"
                )
        for sensor in self.estimator.sensors:
            if (sensor.kind, sensor.name) not in emulated:
                raise ValueError(
                    f"estimator.sensors: no {sensor.kind} called {sensor.name!r} is emulated; sensors has "
                    f"{self._emulated}: add it there, or remove it here"
                )
        return self

    @property
    def _emulated(self) -> str:
        return ", ".join(f"{sensor.kind} {sensor.name!r}" for sensor in self.sensors) or "none"
