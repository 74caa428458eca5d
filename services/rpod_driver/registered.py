"""Drivers by their names: those of the project and those that other installed packages bring.

A package declares ``name = "module:ATTRIBUTE"`` under the entry point group ``rpod.drivers``, where the
attribute is an ``Adapter``. It imports little; the driver's own module is named by a reference, and imported
when the driver is started.
"""

from dataclasses import dataclass
from typing import Any

from rpod_driver.errors import MissingSdkError
from rpod_driver.ports import Driver
from rpod_schemas.config.driver import DriverConfig
from rpod_schemas.registry import DRIVERS, check_type, names, resolve


@dataclass(frozen=True)
class Adapter:
    """The driver of a family of devices, which ``rpod driver run`` starts by its name."""

    name: str
    """Name; that of its entry point."""
    title: str
    """Devices that it connects, for lists."""
    config: type[DriverConfig]
    """Its configuration: that of a driver, and a field ``device``."""
    build: str
    """Reference to ``(config) -> Driver``; it raises ``MissingSdkError`` where the device's library is not
    installed."""
    tested: str
    """Devices that it was tested with, or "without a device"."""
    needs: str = ""
    """Command that installs its libraries, as ``pip install 'rpod[ifm]'``; empty if nothing."""

    def open(self, config: DriverConfig) -> Driver:
        """Return the driver; the device is not connected yet.

        Raises:
            MissingSdkError: a library that the driver's own module imports is not installed.
            DriverError: the driver cannot be made of this configuration.
        """
        try:
            build = resolve(self.build)
        except ModuleNotFoundError as error:
            needs = self.needs or "install the libraries of the package that brings the driver"
            raise MissingSdkError(self.name, str(error), needs) from error
        built: Driver = build(config)
        return built


def adapter(name: str) -> Adapter:
    """Return an adapter by its name. Raises ``UnknownNameError``, ``RegistryError``."""
    found: Adapter = check_type(DRIVERS, name, Adapter)
    return found


def adapters() -> tuple[Adapter, ...]:
    """Return all adapters in the order of their names. Raises ``RegistryError``."""
    return tuple(adapter(name) for name in names(DRIVERS))


def sdk(module: str, *, driver: str, needs: str) -> Any:
    """Return the module of a device's library.

    Raises:
        MissingSdkError: it is not installed, or cannot be loaded.
    """
    try:
        return resolve(module)
    except (ImportError, OSError) as error:
        raise MissingSdkError(driver, str(error), needs) from error
