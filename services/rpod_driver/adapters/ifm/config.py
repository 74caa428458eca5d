"""Configuration of the driver of ifm O3R heads."""

from pathlib import Path
from typing import Any, Self

from pydantic import Field, model_validator

from rpod_driver.stamps import StampConfig
from rpod_schemas.config.base import Config, Positive
from rpod_schemas.config.driver import DriverConfig
from rpod_schemas.config.pmd.lens import Lens


class IfmDevice(Config):
    """The head: a live one by ``ip`` and ``port``, or a recording."""

    ip: str | None = None
    """Address of the VPU, as 192.168.0.69."""
    port: str = Field(default="port2", pattern=r"^port[0-9]$")
    """Port of the VPU to which the head is connected."""
    settings: dict[str, Any] = Field(default_factory=dict)
    """Settings of the device in its own JSON form, applied at each connection: a restart loses settings that
    were not saved."""
    recording: Path | None = None
    """File of PCIC buffers as the SDK receives them, instead of a device."""
    rate_hz: Positive = 10.0
    """Rate at which a recording's frames are played, Hz."""
    repeat: int = Field(default=1, ge=1)
    """Number of times that a recording is played; its frames are the same each time."""
    calibration: Lens | None = None
    """Lens of the head, from its calibration. Needed where the buffers have none that is known (firmware
    whose TOF_INFO is older than version 3); else the device's own is used."""
    stamps: StampConfig = StampConfig()
    """Conversion of the device's stamps to UTC."""

    @model_validator(mode="after")
    def _there_is_one_source(self) -> Self:
        if (self.ip is None) == (self.recording is None):
            raise ValueError("needs either ip, of a device, or recording, a file of buffers")
        return self


class IfmConfig(DriverConfig):
    """Configuration of the driver ``ifm``."""

    kind: str = Field(default="pmd", pattern="^pmd$")
    """Kind of the sensor."""
    device: IfmDevice
    """The head."""
