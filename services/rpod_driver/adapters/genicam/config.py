"""Configuration of the driver of GenICam cameras."""

from pathlib import Path
from typing import Any, Literal

from pydantic import Field, field_validator

from rpod_driver.stamps import StampConfig
from rpod_schemas.config.base import Config, Positive
from rpod_schemas.config.driver import DriverConfig
from rpod_schemas.config.pmd.lens import Lens


class GenicamDevice(Config):
    """The camera."""

    producer: Path
    """GenTL producer of the camera's maker, a .cti file."""
    select: dict[str, str] = Field(default_factory=dict)
    """Which of the producer's cameras, as ``serial_number: "1234"`` (also ``id_``, ``model``, ``vendor``,
    ``user_defined_name``); needed where it finds several."""
    settings: tuple[dict[str, bool | int | float | str], ...] = ()
    """Features of the camera by name, written in this order at each connection: without power, a camera loses
    features that were not saved in it. A list of such mappings is taken, too: a selector can be written again
    in the next one."""
    trigger: Literal["none", "software", "hardware"] = "none"
    """Start of each frame: by itself, by the driver at ``trigger_rate_hz``, or by ``trigger_line``. ``none``
    writes TriggerMode Off, unless ``settings`` write TriggerMode."""
    trigger_rate_hz: Positive = 10.0
    """Rate of software triggers, Hz."""
    trigger_line: str = "Line0"
    """Input of hardware triggers, a value of TriggerSource."""
    calibration: Lens | None = None
    """Lens, inline or as the path of a file; else the camera's Scan3dFocalLength and
    Scan3dPrincipalPoint are used."""
    stamps: StampConfig = StampConfig()
    """Conversion of the camera's stamps to UTC."""

    @field_validator("settings", mode="before")
    @classmethod
    def _one_mapping_is_a_list_of_one(cls, given: Any) -> Any:
        return (given,) if isinstance(given, dict) else given


class GenicamConfig(DriverConfig):
    """Configuration of the driver ``genicam``."""

    kind: str = Field(default="pmd", pattern="^pmd$")
    """Kind of the sensor."""
    device: GenicamDevice
    """The camera."""
