"""Ouster LIDARs through ``ouster-sdk``, live or from a pcap or osf file.

The SDK pins an older rosbags than the project (0.9), so that both cannot be in one environment: it runs in
one of its own, ``scans.py`` in a process of its own.
"""

from pathlib import Path

from pydantic import Field

from rpod_driver.foreign import ForeignDriver
from rpod_driver.foreign.config import ForeignEnvironment
from rpod_driver.registered import Adapter
from rpod_schemas.config.driver import DriverConfig


class OusterDevice(ForeignEnvironment):
    """The sensor, or a recording of it."""

    source: str
    """Name or address of the sensor, or path of a pcap or osf file, which is played at its pace as if its
    scans were taken now."""
    metadata: Path | None = None
    """JSON file of the sensor that recorded a pcap file."""
    sensor_index: int | None = Field(default=None, ge=0)
    """Which of the sensors of a file, from 0; needed where it holds several."""
    ptp_offset_s: float = Field(default=37.0, allow_inf_nan=False)
    """Length by which a PTP master is ahead of UTC, s, subtracted where the sensor is in TIME_FROM_PTP_1588:
    37 for TAI, 0 for a master that keeps UTC."""


class OusterConfig(DriverConfig):
    """Configuration of the driver ``ouster``."""

    kind: str = Field(default="lidar", pattern="^lidar$")
    """Kind of the sensor."""
    device: OusterDevice
    """The sensor."""


def open_driver(config: OusterConfig) -> ForeignDriver:
    """Return the driver; its process is started by ``connect``.

    The stamps of a recording are mapped to now, however young it is.
    """
    device = config.device
    arguments = ["--ptp-offset", f"{device.ptp_offset_s:g}"]
    if device.sensor_index is not None:
        arguments += ["--sensor-index", str(device.sensor_index)]
    if Path(device.source).expanduser().is_file():
        arguments += ["--play"]
        stamps = device.stamps.model_copy(update={"source": "mapped"})
        device = device.model_copy(update={"stamps": stamps})
    arguments += [device.source]
    arguments += [str(device.metadata)] if device.metadata else []
    return ForeignDriver(config, device, Path(__file__).with_name("scans.py"), arguments)


OUSTER = Adapter(
    name="ouster",
    title="Ouster OS (LIDAR), live or a pcap or osf file",
    config=OusterConfig,
    build="rpod_driver.adapters.ouster:open_driver",
    tested="on recorded packets of an OS-0-32 and an OS-1-32; live without a device",
    needs="an environment of its own: python -m venv VENV; VENV/bin/pip install ouster-sdk",
)
