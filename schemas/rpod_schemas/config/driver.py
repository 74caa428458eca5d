"""Configuration of a sensor's driver: the sensor, its mount, and limits of its silence."""

from typing import Annotated, Self

from pydantic import Field, StrictBool, StrictInt, StrictStr, field_validator, model_validator

from rpod_schemas.config.base import Name, Positive
from rpod_schemas.config.mount_calibration import Mount
from rpod_schemas.config.pmd.reduced_rate import ReducedRateConfig
from rpod_schemas.config.service import ServiceConfig
from rpod_schemas.errors import SchemaError
from rpod_schemas.poses import make_pose
from rpod_schemas.sensors import sensor_kind, sensor_kinds

Setting = StrictBool | StrictInt | Annotated[float, Field(allow_inf_nan=False)] | StrictStr
"""Value of a setting of a device."""


class DriverConfig(ServiceConfig):
    """Configuration of a driver, which publishes the frames of one sensor."""

    instance: Name = "driver"
    """Name of the process on the bus; each driver needs its own."""
    kind: str
    """Kind of the sensor: ``pmd``, ``lidar``, or one that another installed package brings."""
    name: Name
    """Name of the sensor: the first part of its topics."""
    T_chaser_sensor: Mount = Field(default_factory=make_pose)
    """Mount: pose of the sensor's (optical) frame in the chaser, or the file of ``rpod calibrate mount``."""
    silence_s: Positive = 3.0
    """Longest time without a frame, s; a longer one is an error, after which the sensor is reconnected."""
    retry_s: Positive = 1.0
    """Wait after the first failure to connect, s; it doubles with each further one."""
    max_retry_s: Positive = 30.0
    """Longest wait between two attempts to connect, s."""

    settings: dict[str, Setting] = Field(default_factory=dict)
    """Settings of the device by name, written after each connection; the driver's documents name them."""
    reduced_rate: ReducedRateConfig | None = None
    """Stream of reduced rate for a slow link, beside the full one."""
    trigger_timeout_s: Positive = 1.0
    """Longest time from a requested trigger to its frame, s; a longer one counts as ``trigger_missed``."""

    @field_validator("kind")
    @classmethod
    def _the_kind_is_known(cls, kind: str) -> str:
        try:
            return sensor_kind(kind).name
        except SchemaError as error:
            raise ValueError(str(error)) from error

    @model_validator(mode="after")
    def _the_kind_has_a_stream_of_reduced_rate(self) -> Self:
        if self.reduced_rate is not None and not sensor_kind(self.kind).reduced_rate:
            able = ", ".join(kind.name for kind in sensor_kinds() if kind.reduced_rate)
            raise ValueError(f"reduced_rate is for sensors of kind {able}, not {self.kind}: leave it out")
        return self

    @model_validator(mode="after")
    def _waits_are_in_order(self) -> Self:
        if self.max_retry_s < self.retry_s:
            raise ValueError(
                f"max_retry_s is {self.max_retry_s:g}, shorter than retry_s, {self.retry_s:g}: raise it, or "
                "lower retry_s"
            )
        return self
