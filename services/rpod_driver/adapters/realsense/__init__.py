"""Intel RealSense depth cameras through ``pyrealsense2``."""

from pydantic import Field

from rpod_driver.registered import Adapter
from rpod_driver.stamps import StampConfig
from rpod_schemas.config.base import Config
from rpod_schemas.config.driver import DriverConfig


class RealsenseDevice(Config):
    """The camera."""

    serial: str = ""
    """Serial number; needed where several cameras are connected."""
    width: int = Field(default=848, ge=1)
    """Width of depth and infrared images, px."""
    height: int = Field(default=480, ge=1)
    """Height of depth and infrared images, px."""
    rate_hz: int = Field(default=30, ge=1)
    """Rate of the images, Hz."""
    infrared: bool = True
    """Whether the left infrared image, which has the depth image's pixels, is sent as amplitude."""
    options: dict[str, float] = Field(default_factory=dict)
    """Options of the depth sensor by their names in the SDK, as ``emitter_enabled: 1``, written at each
    connection."""
    stamps: StampConfig = StampConfig()
    """Conversion of the camera's stamps to UTC."""


class RealsenseConfig(DriverConfig):
    """Configuration of the driver ``realsense``."""

    kind: str = Field(default="pmd", pattern="^pmd$")
    """Kind of the sensor."""
    device: RealsenseDevice = RealsenseDevice()
    """The camera."""


REALSENSE = Adapter(
    name="realsense",
    title="Intel RealSense depth camera",
    config=RealsenseConfig,
    build="rpod_driver.adapters.realsense.driver:open_driver",
    tested="with the SDK's software device; without a device",
    needs="pip install 'rpod[realsense]'",
)
