"""Any device, by a driver process of one's own in an environment of its own."""

from pydantic import Field

from rpod_driver.foreign import ForeignDriver, ProcessDevice
from rpod_driver.registered import Adapter
from rpod_schemas.config.driver import DriverConfig


class ProcessConfig(DriverConfig):
    """Configuration of the driver ``process``."""

    kind: str = Field(pattern="^(pmd|lidar)$")
    """Kind of the sensor: ``pmd`` or ``lidar``."""
    device: ProcessDevice
    """The process."""


def open_driver(config: ProcessConfig) -> ForeignDriver:
    """Return the driver; its process is started by ``connect``."""
    device = config.device
    return ForeignDriver(config, device, device.script, device.arguments)


PROCESS = Adapter(
    name="process",
    title="Any device, by a script in an environment of its own",
    config=ProcessConfig,
    build="rpod_driver.adapters.process:open_driver",
    tested="with a script that needs no device",
    needs="an environment with the device's library and NumPy",
)
