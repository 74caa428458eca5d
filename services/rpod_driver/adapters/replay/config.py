"""Configuration of the driver that plays recordings."""

from pathlib import Path
from typing import Self

from pydantic import Field, model_validator

from rpod_schemas.config.base import Config, Positive
from rpod_schemas.config.driver import DriverConfig
from rpod_schemas.config.pmd.lens import Lens
from rpod_schemas.config.source import Source, SourceConfig


class Images(Config):
    """A folder of PNG images of a depth camera."""

    folder: Path
    """Folder of the images; they are played in the order of their names."""
    depth: str = "*.png"
    """Pattern of the depth images' names; 16 bits, one channel, 0 or 65535 where there is no depth."""
    amplitude: str | None = None
    """Pattern of the amplitude images' names, as many as of depth; 8 or 16 bits, one channel."""
    metres_per_count: Positive = 0.001
    """Depth of one count, m."""
    radial: bool = False
    """Whether the images hold distances along the pixels' rays, not z-depth."""
    camera: Lens
    """The camera's size, fx, fy, cx, cy and distortion, inline or as the path of a file."""
    rate_hz: Positive = 10.0
    """Rate of the images, Hz: they carry no stamps."""


class ReplayDevice(Config):
    """The recording."""

    bag: Path | None = None
    """Folder of a rosbag2, or its .db3 or .mcap file; a log of the facility is one."""
    source: Source = SourceConfig()
    """Topics, stamps and units of the recorded driver, where it did not keep to the ICD. The same as
    ``source`` of a sensor of the estimator."""
    images: Images | None = None
    """Folder of images instead of a bag."""
    speed: Positive = 1.0
    """Speed relative to the recording."""
    repeat: int = Field(default=1, ge=1)
    """Number of times that the recording is played."""

    @model_validator(mode="after")
    def _there_is_one_recording(self) -> Self:
        if (self.bag is None) == (self.images is None):
            raise ValueError("needs either bag, a rosbag2 or MCAP file, or images, a folder")
        return self


class ReplayConfig(DriverConfig):
    """Configuration of the driver ``replay``."""

    device: ReplayDevice
    """The recording."""

    @model_validator(mode="after")
    def _images_are_of_a_camera(self) -> Self:
        if self.device.images is not None and self.kind != "pmd":
            raise ValueError(f"images are of a camera, kind is {self.kind!r}; set kind to pmd")
        return self
